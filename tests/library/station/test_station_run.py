"""What a caller does with one run of a real station, beyond its component images."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation


@pytest.fixture(scope="module")
def run() -> Iterator[vaoi.StationRun]:
    station = HeldStation()
    station.film(board_id="SN-1")
    served = Served(station)
    yield vaoi.connect(served.url).run()
    served.stop()


def test_a_frame_is_an_array(run: vaoi.StationRun) -> None:
    frame = run.frame(0, 0)
    assert frame.ndim == 2
    assert frame.dtype == np.uint8
    with pytest.raises(vaoi.StateError, match="has holes"):
        run.frame(0, 1)
    assert run.frame(0, 1, incomplete=True).shape == frame.shape
    with pytest.raises(vaoi.InputError, match="row is -1"):
        run.frame(0, -1)


def test_the_verdict_of_the_run_counts_with_its_reasons(run: vaoi.StationRun) -> None:
    """A board id that differs degrades the run, not its matrices."""
    assert (run.status, run.reasons) == ("ok", run.result.reasons)
    differs = {"code": "board-id-differs", "message": "The code states SN-2."}
    degraded = replace(run, summary=run.summary | {"verdict": "degraded", "reasons": [differs]})
    assert degraded.result.status == "ok"
    assert (degraded.status, degraded.reasons) == ("degraded", (*run.result.reasons, "The code states SN-2."))


def test_a_region_has_pictures(run: vaoi.StationRun) -> None:
    found = run.region((10, 10, 20, 20), limit=1)
    assert (found.address, len(found.pixels)) == ("region", 1)


@pytest.mark.parametrize("region", [(1, 2, 3), "1,2,3,4", (0, 0, float("nan"), 1), 7])
def test_a_wrong_region_is_refused(run: vaoi.StationRun, region: object) -> None:
    with pytest.raises(vaoi.InputError, match="region is"):
        run.region(region)  # type: ignore[arg-type]


def test_a_hold_says_how_long_it_lasts_and_is_ended(run: vaoi.StationRun) -> None:
    assert run.hold("tester", "reads").expires_in_s > 0
    run.end_hold("tester")


def test_a_decision_needs_a_reason(run: vaoi.StationRun) -> None:
    with pytest.raises(vaoi.InputError, match="decide: reason is ''"):
        run.decide("use", "J. Doe", "")


def test_two_files_that_are_written_at_once_are_both_complete(tmp_path: Path) -> None:
    target = tmp_path / "board.tif"

    class Reply(io.BytesIO):
        headers: Mapping[str, str] = {"Content-Length": "5"}

        def read(self, size: int | None = -1) -> bytes:
            if replies:
                run.save_mosaic("all", target)
                assert target.read_bytes() == b"other"
            return super().read(size)

    replies = [Reply(b"other"), Reply(b"first")]
    client = Mock(opened=lambda *_, **__: nullcontext(replies.pop()))
    run = vaoi.StationRun("r1", {}, client)
    run.save_mosaic("all", target)
    assert target.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [target]
