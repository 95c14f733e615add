"""Small pictures of whole boards: made in spare time, within a quota, deleted with their runs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.mosaic.conftest import Filmed, board, film
from tests.runs.mosaics.test_mosaics import mosaics_of
from vaoi_station.config import KeepConfig
from vaoi_station.errors import GoneError
from vaoi_station.runs.mosaics import kept_mosaics
from vaoi_station.runs.mosaics.kept_mosaics import KeptMosaics
from vaoi_station.runs.workers.jobs import Priority

__all__ = ["board", "film"]


class Station:
    """Runs of one board, whose frames may be gone, and a line that may be busy."""

    def __init__(self, board: Filmed, directory: Path, quota_gb: float = 1.0) -> None:
        self.jobs: list[Any] = []
        self.mosaics = mosaics_of(board, self.jobs)
        self.gone: set[str] = set()
        self.forgotten: set[str] = set()
        self.pinned: set[str] = set()
        self.events: list[dict[str, Any]] = []
        self.boards = 0
        """Number of further checks at which a board is under way."""
        self.directory = directory / "mosaics"
        self.kept = self.opened(quota_gb)

    def opened(self, quota_gb: float = 1.0) -> KeptMosaics:
        """Return the pictures as a new start of the station finds them."""
        archive: Any = SimpleNamespace(
            get=lambda run: None,
            retention=SimpleNamespace(pins=lambda: frozenset(self.pinned)),
            summaries=lambda runs: {r: SimpleNamespace(forgotten=r in self.forgotten) for r in runs},
        )
        events: Any = SimpleNamespace(add=lambda kind, message, **fields: self.events.append(fields))
        keep = KeepConfig(mosaics_gb=quota_gb)
        station: Any = self
        return KeptMosaics(self.directory, keep, archive, self.mosaics, station, events, clock=lambda: 0.0)

    def bay_of(self, run: str) -> Any:
        if run in self.gone:
            raise GoneError("The frames are no longer in memory.", code="frames-gone")
        return SimpleNamespace(number=0, generation=1)

    def busy(self) -> bool:
        self.boards -= 1
        return self.boards >= 0

    def make(self, *runs: str) -> None:
        """Have the pictures of runs made, as the thread does."""
        for run in runs:
            self.kept._make((run, 0.0))


@pytest.fixture
def station(board: Filmed, tmp_path: Path) -> Station:
    return Station(board, tmp_path)


def test_the_picture_shows_the_board_as_the_mosaic_does(station: Station, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_mosaics, "MOST_PX", 20_000)
    station.make("r1")
    grid = station.kept.grid("r1")
    assert grid is not None
    content = station.kept.content("r1")
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape[:2] == (grid.height, grid.width)
    assert grid.width * grid.height <= 20_000 * 1.1
    whole, _ = station.mosaics.small("r1", 10**9, station.kept._spare)
    assert abs(float(picture.mean()) - float(whole.mean())) < 3
    assert {job.priority for job in station.jobs} == {Priority.OVERVIEW}
    again = station.opened()
    assert again.content("r1") == content, "it is there after a restart"
    assert (again.runs, again.size_bytes) == (1, len(content))


def test_the_oldest_makes_room_and_pinned_runs_stay(board: Filmed, tmp_path: Path) -> None:
    first = Station(board, tmp_path)
    first.make("r1")
    size = first.kept.size_bytes
    station = Station(board, tmp_path / "other", quota_gb=2.5 * size / 1e9)
    station.pinned.add("r1")
    station.make("r1", "r2", "r3")
    assert [run for run in ("r1", "r2", "r3") if station.kept.grid(run)] == ["r1", "r3"]
    assert len(list(station.directory.glob("*.jpg"))) == 2


def test_a_full_disk_is_reported(station: Station) -> None:
    station.directory.parent.mkdir(exist_ok=True)
    station.directory.write_text("no directory")
    station.make("r1")
    assert [event["code"] for event in station.events] == ["mosaic-not-kept"]
