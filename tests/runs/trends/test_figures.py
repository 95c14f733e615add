"""The figures of a board: what verdict, watch and clock know of it, and what they depend on."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.drift.checks import CameraCheck, LampBaseline, LampCheck, RunCheck
from vaoi_station.model import FrameRecord, Status, Stitch, Verdict
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of
from vaoi_station.runs.states.schemas import BeltSpeed, RunDetail, Timings
from vaoi_station.runs.trends.figures import FIGURES, figures_of, figures_of_check


def frames(missing: bool = False) -> tuple[FrameRecord, ...]:
    lit = [
        FrameRecord(
            camera=0, row=r, verdict=Verdict.OK, exposure_us=100.0 + r % 2, gain=2.0, light=("left", "right")[r % 2]
        )
        for r in range(4)
    ]
    return (*lit, *([FrameRecord(camera=0, row=4, verdict=Verdict.MISSING)] if missing else []))


@pytest.fixture
def detail(progress: Progress) -> RunDetail:
    update: dict[str, Any] = {
        "belt": BeltSpeed(nominal_mm_s=(100, 0), measured_mm_s=(0, 101), ratio=1.01),
        "timings": Timings(
            filming_s=1, ready_after_last_frame_ms=80.1234567, links_ms=1, conclude_ms=1, links=1, links_while_filming=1
        ),
        "frames": frames(),
    }
    return detail_of(progress).model_copy(update=update)


def test_every_figure_of_a_result_is_kept(detail: RunDetail) -> None:
    quality = {"residual_px": {"median": 0.06}, "seams_px": {"0-1": 0.1}, "cad_sigma_px": 0.05}
    stitch = Stitch(
        method="auto",
        image_matrices=(),
        cad_matrix=None,
        row_motion=(),
        status=Status.OK,
        quality=quality,
    )
    found = figures_of(detail, stitch)
    assert found == {
        "residual_px": 0.06, "seam_px:0-1": 0.1, "sigma_px": 0.05, "unseen_parts": 0, "belt_mm_s": 101,
        "slip_percent": 1, "ready_ms": 80.123, "lost_frames": 0,
    }  # fmt: skip
    assert {key.partition(":")[0] for key in found} | {"brightness_percent", "drift_px"} == set(FIGURES)


def test_brightness_is_compared_with_the_first_boards() -> None:
    def camera(links: int) -> CameraCheck:
        return CameraCheck(
            x_px=3, y_px=4, turn_px=0, sigma_px=(1, 1, 1), rms_px=None, left_px=None, links=links, fiducials=0
        )

    base = LampBaseline(brightness=0.5, scatter=0.01, grey=50, points=100)
    lamps = (
        LampCheck(camera=0, light="left", exposure=100, grey=45, points=100, baseline=base),
        LampCheck(camera=0, light="left", exposure=200, grey=100, points=100, baseline=base),
        LampCheck(camera=1, light="", exposure=100, grey=50, points=100, baseline=base),
        LampCheck(camera=1, light="right", exposure=100, grey=50, points=100),
    )
    check = RunCheck(
        run="r1",
        time="",
        board_type="b",
        cameras=(camera(9), camera(0)),
        rivals=(),
        information=(),
        vector=(),
        lamps=lamps,
    )
    assert figures_of_check(check, ("a", "b")) == {
        "drift_px:a": 5, "brightness_percent:a/left": 95, "brightness_percent:b": 100,
    }  # fmt: skip
