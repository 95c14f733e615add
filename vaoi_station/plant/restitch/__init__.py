"""Archived runs stitched again on a Dask cluster, by the code of the station.

Dask distributes one task per run. What counts as done is on the disk: one file per run, written atomically by the
command. So neither a worker, nor the scheduler, nor the command must live on for its work to remain.
"""

from vaoi_station.plant.restitch.session import Session, Summary, restitch
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.plant.workers.cluster import ClusterOptions

__all__ = ["ClusterOptions", "Session", "Summary", "Terms", "restitch"]
