"""One small simulated recording and its result, shared by the session."""

from __future__ import annotations

import pytest

import vaoi_station as vaoi


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> vaoi.RecordedRun:
    return vaoi.simulate("small", tmp_path_factory.mktemp("library") / "recording")


@pytest.fixture(scope="session")
def stitched(recording: vaoi.RecordedRun) -> vaoi.StitchedRun:
    return recording.stitch()
