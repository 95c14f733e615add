"""Fiducials that lie, painted into the frames of a board of the twin: a result is right, admits its error, or warns."""

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
    """The frames, changed at the true places of all fiducials in view."""
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


@pytest.mark.parametrize("off", [(2.5, 0.0), (1.2, 0.0), (-1.2, 0.0), (0.8, 0.8)])
def test_look_alikes_beside_all_fiducials_do_not_agree_with_the_outline(filmed: Any, off: tuple[float, float]) -> None:
    result = filmed.stitched(frames=painted(filmed, look_alikes(*off)))
    assert result.status is not Status.OK
    if result.status is Status.DEGRADED:
        assert any("the board's outline lies" in r and "look-alikes" in r for r in result.reasons), result.reasons
        assert np.hypot(*result.quality["outline_shift_mm"]["mm"]) == pytest.approx(np.hypot(*off), abs=0.15)


def test_the_outline_of_a_sound_board_lies_where_the_fiducials_put_it(filmed: Any) -> None:
    shift = filmed.stitch.quality["outline_shift_mm"]
    assert np.abs(shift["mm"]).max() < 0.1
    assert 0 < max(shift["sigma_mm"]) < 0.2
    assert shift["pieces"] >= 20


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("off", [(0.1, 0.0), (0.0, -0.1)])
def test_of_three_fiducials_the_wrong_one_is_named(filmed: Any, which: int, off: tuple[float, float]) -> None:
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    data["fiducials"][which]["x"] += off[0]
    data["fiducials"][which]["y"] += off[1]
    result = filmed.stitched(board_type=BoardType.model_validate(data))
    assert result.status is Status.DEGRADED
    named = [r for r in result.reasons if r.startswith("without fiducial")]
    assert not named or f"fiducial FID{which + 1} " in named[0]


@pytest.mark.parametrize("share", [0.001, -0.001, 0.003])
def test_data_that_are_scaled_are_told(filmed: Any, share: float) -> None:
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    for mark in data["fiducials"]:
        mark["x"], mark["y"] = mark["x"] * (1 + share), mark["y"] * (1 + share)
    flat = filmed.calibration.model_copy(update={"working_distance_mm": None})
    result = filmed.stitched(board_type=BoardType.model_validate(data), calibration=flat)
    assert result.status is Status.DEGRADED
    assert any("larger than its CAD data" in r for r in result.reasons), result.reasons
