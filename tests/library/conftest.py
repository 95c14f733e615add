"""One small simulated recording and its result, shared by the session, and a station over a real socket."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> vaoi.RecordedRun:
    return vaoi.simulate("small", tmp_path_factory.mktemp("library") / "recording")


@pytest.fixture(scope="session")
def stitched(recording: vaoi.RecordedRun) -> vaoi.StitchedRun:
    return recording.stitch()


@pytest.fixture
def served() -> Iterator[Served]:
    """Return a station that has filmed the board SN-1."""
    station = HeldStation()
    station.film(board_id="SN-1")
    served = Served(station)
    yield served
    served.stop()
