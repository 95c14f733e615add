"""The check of a recording on disk is the one the station makes of the same run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.drift.check_run import check_recording
from vaoi_station.drift.checks import RunCheck
from vaoi_station.simulation import Twin
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.recordings.opening import open_run


@pytest.fixture(scope="module")
def recording(knocked_twin: Callable[..., Twin], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drift") / "run"
    write_passage(knocked_twin().passage(0), out, with_truth=False)
    return out


def test_a_recording_is_checked_like_a_run_of_the_station(recording: Path, undisturbed: list[RunCheck]) -> None:
    check = check_recording(open_run(recording))
    live = undisturbed[0]
    assert check.run == str(recording)
    assert check.time == ""
    assert [c.links for c in check.cameras] == [c.links for c in live.cameras]
    for ours, theirs in zip(check.cameras, live.cameras, strict=True):
        assert ours.displacement_px == pytest.approx(theirs.displacement_px, abs=1e-4)
    np.testing.assert_allclose(check.vector, live.vector, rtol=1e-3, atol=1e-2)
