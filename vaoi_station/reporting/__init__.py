"""One HTML file that shows how a run was stitched, and a bundle from which it can be stitched again."""

from vaoi_station.reporting.bundle import write_bundle
from vaoi_station.reporting.document import write_report
from vaoi_station.reporting.restitched import Story, tell

__all__ = ["Story", "tell", "write_bundle", "write_report"]
