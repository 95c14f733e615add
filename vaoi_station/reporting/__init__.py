"""Report how a run was stitched as one HTML file, and bundle everything that is needed to stitch it again."""

from vaoi_station.reporting.report import write_bundle, write_report
from vaoi_station.reporting.stitched_run import StitchedRun, restitch

__all__ = ["StitchedRun", "restitch", "write_bundle", "write_report"]
