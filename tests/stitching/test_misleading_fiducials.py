"""Misleading fiducials in the frames of a simulated board: the result is right, states its error, or warns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Status

Picture = NDArray[np.uint8]
Paint = Callable[[Picture, NDArray[np.float64], float], None]
"""Changes a picture at a fiducial's place, given the pixels per mm."""

MASK, COPPER = 55, 205
"""Grey levels."""


def painted(filmed: Any, paint: Paint) -> dict[tuple[int, int], Picture]:
    """Change the frames at the true places of all fiducials in view."""
    fiducials = np.array([(f.x, f.y) for f in filmed.board_type.fiducials])
    cameras = filmed.calibration.cameras(filmed.head.cameras)
    frames = {}
    for (i, j), frame in filmed.frames.items():
        image_from_cad = filmed.truth["image_matrices"][i][j] @ np.asarray(filmed.truth["cad_matrix"])
        places = cameras[i].lens.distort(apply(image_from_cad, fiducials))
        frames[i, j] = frame.copy()
        for place in places[cameras[i].sees(places, 3 * cameras[i].px_per_mm)]:
            paint(frames[i, j], place, cameras[i].px_per_mm)
    return frames


def disc(picture: Picture, place: NDArray[np.float64], radius: float, grey: int) -> None:
    x, y = (round(float(v) * 16) for v in place)
    cv2.circle(picture, (x, y), round(radius * 16), grey, -1, cv2.LINE_AA, 4)


def look_alikes(x_mm: float, y_mm: float) -> Paint:
    def paint(picture: Picture, place: NDArray[np.float64], px_per_mm: float) -> None:
        disc(picture, place, 0.7 * px_per_mm, MASK)
        beside = place + np.array([x_mm, y_mm]) * px_per_mm
        disc(picture, beside, 1.1 * px_per_mm, MASK)
        disc(picture, beside, 0.5 * px_per_mm, COPPER)

    return paint


def cover(from_mm: float) -> Paint:
    """Cover a mark from there on to the right."""

    def paint(picture: Picture, place: NDArray[np.float64], px_per_mm: float) -> None:
        x, y = place
        left, right = round(float(x) + from_mm * px_per_mm), round(float(x) + px_per_mm)
        picture[round(float(y) - px_per_mm) : round(float(y) + px_per_mm), left:right] = MASK

    return paint


def glare(levels: float) -> Paint:
    """Paint a spot of light beside the mark that reaches over it."""

    def paint(picture: Picture, place: NDArray[np.float64], px_per_mm: float) -> None:
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
        u, v = (x - place[0]) / px_per_mm - 0.4, (y - place[1]) / px_per_mm - 0.2
        picture[:] = np.clip(picture + levels * np.exp(-2 * (u**2 + v**2)), 0, 255)

    return paint


@pytest.mark.parametrize("paint", [cover(0.4), cover(0.35), cover(0.3), glare(60), glare(120), glare(180)])
def test_covered_or_glaring_marks_state_their_error(filmed: Any, paint: Paint) -> None:
    result = filmed.stitched(frames=painted(filmed, paint))
    if result.status is Status.FAILED:
        return
    assert filmed.error_px(result) <= 3.5 * result.quality["cad_sigma_px"]
    if filmed.error_px(result) > 0.4:
        assert result.status is Status.DEGRADED
        assert any("partly covered, smudged or in a glare: FID" in r for r in result.reasons), result.reasons


def test_glare_on_some_detections_leaves_the_weight_of_the_others(filmed: Any) -> None:
    """Every fiducial is seen twice; only in odd rows is there a reflection."""
    bright = painted(filmed, glare(120))
    result = filmed.stitched(frames={k: bright[k] if k[1] % 2 else frame for k, frame in filmed.frames.items()})
    assert filmed.error_px(result) <= 3.5 * result.quality["cad_sigma_px"]
    assert result.quality["cad_sigma_px"] < 0.2


@pytest.mark.parametrize("off", [(2.5, 0.0), (1.2, 0.0), (-1.2, 0.0), (0.8, 0.8)])
def test_look_alikes_beside_all_fiducials_do_not_agree_with_the_outline(filmed: Any, off: tuple[float, float]) -> None:
    result = filmed.stitched(frames=painted(filmed, look_alikes(*off)))
    assert result.status is not Status.OK
    if result.status is Status.DEGRADED:
        assert any(
            "the board's outline lies" in r and "other marks may have been taken" in r for r in result.reasons
        ), result.reasons
        assert np.hypot(*result.quality["outline_shift_mm"]["mm"]) == pytest.approx(np.hypot(*off), abs=0.15)


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("off", [(0.1, 0.0), (0.0, -0.1)])
def test_the_wrong_one_of_three_fiducials_is_named(filmed: Any, which: int, off: tuple[float, float]) -> None:
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    data["fiducials"][which]["x"] += off[0]
    data["fiducials"][which]["y"] += off[1]
    result = filmed.stitched(board_type=BoardType.model_validate(data))
    assert result.status is Status.DEGRADED
    named = [r for r in result.reasons if r.startswith("without fiducial")]
    assert not named or f"fiducial FID{which + 1} " in named[0]


@pytest.mark.parametrize("share", [0.001, -0.001, 0.003])
def test_scaled_cad_data_are_reported(filmed: Any, share: float) -> None:
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    for mark in data["fiducials"]:
        mark["x"], mark["y"] = mark["x"] * (1 + share), mark["y"] * (1 + share)
    flat = filmed.calibration.model_copy(update={"working_distance_mm": None})
    result = filmed.stitched(board_type=BoardType.model_validate(data), calibration=flat)
    assert result.status is Status.DEGRADED
    assert any("larger than its CAD data" in r for r in result.reasons), result.reasons


def test_two_fiducials_of_which_one_lies_across_turn_the_outline(filmed: Any) -> None:
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    data["fiducials"] = data["fiducials"][:2]
    (ax, ay), (bx, by) = ((f["x"], f["y"]) for f in data["fiducials"])
    length = np.hypot(bx - ax, by - ay)
    data["fiducials"][0]["x"] += -0.6 * (by - ay) / length
    data["fiducials"][0]["y"] += 0.6 * (bx - ax) / length
    result = filmed.stitched(board_type=BoardType.model_validate(data))
    assert result.status is Status.DEGRADED
    assert any("the board's outline is turned by" in r for r in result.reasons), result.reasons
