"""Persistent data: runs, results, calibrations and events in one SQLite file; board types as JSON files."""

from vaoi_station.store.board_types import BoardTypeDirectory, BoardTypeFile
from vaoi_station.store.database import Database
from vaoi_station.store.documents import RunRow, Store
from vaoi_station.store.storage_trouble import StorageTrouble

__all__ = ["BoardTypeDirectory", "BoardTypeFile", "Database", "RunRow", "StorageTrouble", "Store"]
