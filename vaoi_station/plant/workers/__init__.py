"""Work on archived runs by the processes of a Dask cluster: one task per run, whatever the task is.

Dask distributes. Which workers may be used, and what becomes of a run whose worker or scheduler has ended, is decided
here.
"""

from vaoi_station.plant.workers.cluster import ClusterOptions, cluster_address, dashboard_link
from vaoi_station.plant.workers.dispatch import Dispatch

__all__ = ["ClusterOptions", "Dispatch", "cluster_address", "dashboard_link"]
