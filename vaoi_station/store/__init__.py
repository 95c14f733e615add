"""What outlives a restart: runs, results, calibrations seen and events in SQLite; board types as files."""

from vaoi_station.store.board_types import BoardTypeDirectory, BoardTypeFile
from vaoi_station.store.database import Database
from vaoi_station.store.documents import EventRow, RunRow, Store

__all__ = ["BoardTypeDirectory", "BoardTypeFile", "Database", "EventRow", "RunRow", "Store"]
