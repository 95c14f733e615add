"""Tests of the rows of neighbouring cameras: a camera that is one row off is named, and not said to have moved."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stitching.conftest import Filmed
from tests.stitching.quality.test_findings import findings_of
from vaoi_station.geometry import apply
from vaoi_station.model import Status
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.quality.seams import explain_seam, shifted_cameras
from vaoi_station.stitching.quality.verdict import judge_result
from vaoi_station.stitching.work import StitchSetup

Frames = dict[tuple[int, int], NDArray[Any]]


def film(**changes: dict[str, Any]) -> Filmed:
    """Film the small board with changed keys of its scenario, by section."""
    scenario = read_scenario(scenario_path("small"))
    sections = {name: getattr(scenario, name).model_copy(update=keys) for name, keys in changes.items()}
    twin = Twin(scenario.model_copy(update=sections))
    passage = twin.passage(0)
    head = passage.head()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    return Filmed(head, twin.calibration, setup, passage.render_all(), passage.truth())


def verdict(filmed: Filmed, frames: Frames | None = None) -> dict[str, str]:
    """Return code and text of the reasons of a run that is not ok; none blames a camera without evidence."""
    status, reasons = judge_result(findings_of(filmed, frames))
    assert status is not Status.OK
    assert not any("has moved" in r.message for r in reasons), reasons
    return {reason.code: reason.message for reason in reasons}


def in_camera_1(frames: Frames, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Frames:
    return {key: change(p) if key[0] == 1 else p for key, p in frames.items()}


def test_a_blank_overlap_is_blank() -> None:
    reasons = verdict(film(board={"density": 0.0}))
    assert "shows no texture beyond noise" in reasons["overlap-blank"]
    assert "camera-displaced" not in reasons
    assert "not-explained" not in reasons


@pytest.mark.parametrize(("cameras", "lift_mm"), [(2, 6.0), (3, -6.0)])
def test_a_lift_beyond_reach_is_measured_by_the_overlaps(cameras: int, lift_mm: float) -> None:
    """No camera is blamed where two overlaps show one height, and a wrong position is not placed."""
    width = 60.0 + 33.5 * (cameras - 2)
    found = findings_of(film(array={"cameras": cameras}, board={"lift_mm": lift_mm, "width_mm": width}))
    status, reasons = judge_result(found)
    assert status is not Status.OK
    assert reasons[0].code == "board-off-plane"
    assert not found.far_off_plane or found.mapping is None
    assert found.lift is not None
    assert found.lift.overlaps == cameras - 1
    assert abs(found.lift.mm - lift_mm) < 0.6
    assert f"about {abs(found.lift.mm):.1f} mm {'above' if lift_mm > 0 else 'below'}" in reasons[0].message
    assert "camera-displaced" not in {reason.code for reason in reasons}
    assert ("one of the two cameras is displaced" in reasons[0].message) == (cameras == 2)


def test_texture_that_noise_hides_in_the_darker_camera_is_a_matter_of_exposure(filmed: Any) -> None:
    g = np.random.default_rng(1)

    def dark(pixels: NDArray[Any]) -> NDArray[Any]:
        return np.clip(np.round(pixels * 0.1 + g.normal(4, 8, pixels.shape)), 2, 255).astype(np.uint8)

    found = findings_of(filmed, in_camera_1(filmed.frames, dark))
    reason = explain_seam(found.scene, found.links, (0, 1), "cameras 0 and 1 disagree", None)
    assert reason.code == "overlap-exposure"
    assert "times as bright as camera 1, and the noise hides its texture" in reason.message


def test_a_grid_of_leds_is_a_repeated_pattern() -> None:
    """Their tops appear shifted in camera 1: the search finds a place that is wrong by whole spacings."""
    filmed, pitch_mm, off_px = film(array={"overlap": 1.3}, board={"density": 0.0}), 1.27, 10
    frames = {}
    for (i, j), pixels in filmed.frames.items():
        y, x = np.mgrid[: pixels.shape[0], : pixels.shape[1]].astype(np.float64)
        ground = filmed.setup.cameras[i].ground(np.stack([x.ravel() - off_px * i, y.ravel()], -1))
        board = apply(np.linalg.inv(filmed.truth["row_motion"][j]), ground)
        off_mm = np.hypot(*(board % pitch_mm - pitch_mm / 2).T).reshape(pixels.shape)
        frames[i, j] = np.clip(pixels + 150 * np.exp(-((off_mm / 0.3) ** 2)), 0, 255).astype(np.uint8)
    assert "fit at several places" in verdict(filmed, frames)["overlap-repetitive"]


@pytest.mark.parametrize("late", [1, -1])
def test_a_camera_whose_frames_are_one_row_off_is_named(filmed: Any, late: int) -> None:
    """Its time stamps are late by nearly a period: every frame is taken for that of the next pulse."""
    frames = {(i, j): filmed.frames[i, j - late * i] for i, j in filmed.frames if (i, j - late * i) in filmed.frames}
    found = findings_of(filmed, frames)
    assert found.row_offsets == {(0, 1): late}
    status, reasons = judge_result(found)
    assert status is not Status.OK
    (reason,) = [r.message for r in reasons if r.code == "wrong-rows"]
    assert f"camera 1 match those of camera 0 one row {'earlier' if late > 0 else 'later'}" in reason
    assert not any("moved" in r.message for r in reasons)


@pytest.mark.parametrize(
    ("offsets", "cameras", "shifted"),
    [
        ({}, 3, {}),
        ({(0, 1): 1}, 2, {}),  # either of the two
        ({(0, 1): 1}, 3, {0: -1}),
        ({(0, 1): 1, (1, 2): -1}, 3, {1: 1}),
        ({(2, 3): -1}, 4, {3: -1}),
        ({(1, 2): 1}, 4, {}),  # two against two
    ],
)
def test_the_cameras_that_differ_from_most_are_shifted(
    offsets: dict[tuple[int, int], int], cameras: int, shifted: dict[int, int]
) -> None:
    assert shifted_cameras(offsets, cameras) == shifted
