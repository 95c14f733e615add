"""An archive: finished runs of many stations as immutable, content-addressed blobs, and one manifest per run.

Blobs are written first, the manifest last, each by one atomic write: a reader sees a complete run or none, an
interrupted addition goes on where it was, and any number of stations write at the same time without a lock.
"""

from vaoi_station.plant.archive.archive import Archive
from vaoi_station.plant.archive.manifest import ArchivedRun, RunLabel
from vaoi_station.plant.archive.selection import RunSelection

__all__ = ["Archive", "ArchivedRun", "RunLabel", "RunSelection"]
