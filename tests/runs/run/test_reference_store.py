"""The store of references: records and methods by board type, and which directories are removed."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import BoardType, Calibration
from vaoi_station.runs.run.reference_store import KEEP, ReferenceStore
from vaoi_station.runs.states.schemas import ReferenceRecord
from vaoi_station.store import Database, Store


@pytest.fixture
def references(config: StationConfig, calibration: Calibration, store: Store) -> ReferenceStore:
    return ReferenceStore(config.data / "references", store, calibration.cameras(config.heads))


def record_of(run: str) -> ReferenceRecord:
    return ReferenceRecord(
        run=run, taught="2026-01-01T00:00:00Z", calibration="c0ffee", cameras=2, rows=3, frames=6, size_bytes=1,
        cad_sigma_px=None,
    )  # fmt: skip


def directory_of(references: ReferenceStore, run: str) -> Path:
    path = references.path_of(run)
    path.mkdir(parents=True)
    (path / "recording.json").write_text("{}")
    return path


def test_records_are_kept_replaced_and_dropped(references: ReferenceStore) -> None:
    assert references.record("small") is None
    for run in ("r1", "r2"):
        references.keep("small", record_of(run))
    assert references.record("small") == record_of("r2")
    for _ in range(2):
        references.drop("small")
    assert references.record("small") is None


def test_only_directories_that_nothing_uses_are_removed(references: ReferenceStore) -> None:
    named, used, unused = (directory_of(references, run) for run in ("r1", "r2", "r3"))
    references.keep("small", record_of("r1"))
    references.sweep({"r2"})
    assert [path.exists() for path in (named, used, unused)] == [True, True, False]
    references.drop("small")
    references.sweep()
    assert not named.exists()
    assert not used.exists()


def test_references_outlive_a_database_that_was_lost(tmp_path: Path) -> None:
    data = tmp_path / "lost"
    reference = data / "references" / "r1"
    reference.mkdir(parents=True)
    (data / "station.db").write_bytes(b"garbage " * 1000)
    for _ in range(2):
        store = Store(Database(data / "station.db"))
        ReferenceStore(data / "references", store, ()).sweep()
        store.close()
        assert reference.is_dir(), "a person may restore the database"
    (data / "references" / KEEP).unlink()
    [aside] = data.glob("station.db.damaged-*Z")
    aside.unlink()
    store = Store(Database(data / "station.db"))
    ReferenceStore(data / "references", store, ()).sweep()
    store.close()
    assert not reference.exists(), "what was set aside was cleared away"


def test_a_record_that_cannot_be_read_keeps_every_reference_and_is_named(
    references: ReferenceStore, store: Store, board_type: BoardType
) -> None:
    unread, unused = (directory_of(references, run) for run in ("r1", "r2"))
    # A later version may add a field; a station that was rolled back must start with it.
    later = record_of("r1").model_dump_json().replace("{", '{"added_later": 1, ', 1)
    store.references.set("small", later).result(10)
    references.sweep()
    assert unread.is_dir()
    assert unused.is_dir()
    with pytest.raises(DeviceError, match="'small' cannot be read"):
        references.open(board_type)
    assert references.has("small")
    references.keep("small", record_of("r1"))
    references.sweep()
    assert [unread.exists(), unused.exists()] == [True, False]
