"""Frames of different resolution, rotation or size are linked in one grid, as accurately as frames that are alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import (
    FramePair,
    overlap_box,
    overlap_polygon,
    predict,
)
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.link import link_neighbours


@pytest.mark.parametrize("degrees", [-170.0, -90.0, -8.0, 5.0, 90.0, 180.0])
def test_the_polygon_holds_the_points_that_both_frames_show(workshop: Any, degrees: float) -> None:
    """The box of frames that are turned against each other is the smallest one around the polygon."""
    a = workshop.camera((0, 0))
    b = workshop.camera((9, 3), angle_rad=np.radians(degrees), px_per_mm=8.0, size_px=(180, 170))
    at = np.zeros(2)
    polygon, box = overlap_polygon(a, b, at), overlap_box(a, b, at)
    assert box is not None
    assert np.abs(np.array(box[:2]) - polygon.min(0)).max() <= 1
    assert np.abs(np.array(box[2:]) - polygon.max(0)).max() <= 1
    seen = predict(polygon, a, b, at)
    assert a.sees(polygon, -0.01).all()
    assert b.sees(seen, -0.01).all()
    inner = overlap_polygon(a, b, at, (5.0, 7.0))
    assert a.sees(inner, 4.99).all()
    assert b.sees(predict(inner, a, b, at), 6.99).all()


SIZE, OTHER_SIZE = (480, 360), (420, 400)
SCALE, OVERLAP_MM, NOISE = 10.0, 13.0, 1.5
TASK = Task("neighbours", (0, 0), (1, 0))
AT = np.zeros(2)
UNLIKE = {
    "coarser": {"px_per_mm": 7.0},
    "finer": {"px_per_mm": 14.0},
    "rolled by 2 degrees": {"angle_rad": np.radians(2.0)},
    "rolled by 10 degrees": {"angle_rad": np.radians(-10.0)},
    "upside down": {"angle_rad": np.radians(180.6)},
    "at 90 degrees": {"angle_rad": np.radians(89.5)},
    "at 270 degrees and coarser": {"angle_rad": np.radians(-90.0), "px_per_mm": 8.0},
    "of another frame size": {"size_px": OTHER_SIZE},
}


def cameras(workshop: Any, design: dict[str, Any]) -> tuple[Camera, Camera]:
    """An ordinary camera, and beside it one of another design, whose views overlap by `OVERLAP_MM`."""
    size, scale = design.get("size_px", SIZE), design.get("px_per_mm", SCALE)
    across = abs(np.sin(design.get("angle_rad", 0.0))) > 0.5
    width_mm = size[1 if across else 0] / scale
    x = (SIZE[0] / SCALE + width_mm) / 2 - OVERLAP_MM
    return workshop.camera((0.0, 0.0), size_px=SIZE), workshop.camera((x, 0.3), **{"size_px": SIZE} | design)


def filmed(workshop: Any, camera: Camera, seed: int, moved_mm: Floats) -> PreparedFrame:
    waves = workshop.waves(11, finest=0.6, coarsest=12.0)
    exact = waves.seen_by(camera, lambda at: at - moved_mm).astype(np.float64)
    noise = np.random.default_rng(seed).normal(0, NOISE, exact.shape)
    return PreparedFrame(np.clip(np.rint(exact + noise), 0, 255).astype(np.uint8))


def pair(workshop: Any, one: Camera, other: Camera, moved_mm: tuple[float, float] = (0.0, 0.0)) -> FramePair:
    still, moved = np.zeros(2), np.array(moved_mm)
    return FramePair(filmed(workshop, one, 1, still), filmed(workshop, other, 2, moved), one, other, still)


def off_px(links: Links, found: FramePair, moved_mm: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """How far the points found in frame b lie from where it shows the points of frame a, (k, 2) px of frame b."""
    return np.asarray(links.b_px - found.camera_b.project(found.camera_a.ground(links.a_px) + moved_mm))


@pytest.mark.parametrize("swapped", [False, True], ids=["second", "first"])
@pytest.mark.parametrize("name", UNLIKE)
def test_an_unlike_neighbour_is_linked_accurately(workshop: Any, name: str, swapped: bool) -> None:
    one, other = cameras(workshop, UNLIKE[name])
    found = pair(workshop, *((other, one) if swapped else (one, other)))
    links = link_neighbours(TASK, found)
    assert len(links.a_px) >= 16
    assert not links.unmatched
    off = off_px(links, found)
    assert np.hypot(*np.median(off, axis=0)) < 0.02
    assert np.sqrt((off**2).sum(1).mean()) < 0.08


@pytest.mark.parametrize("name", ["coarser", "at 270 degrees and coarser"])
def test_the_information_predicts_the_errors(workshop: Any, name: str) -> None:
    found = pair(workshop, *cameras(workshop, UNLIKE[name]))
    links = link_neighbours(TASK, found)
    off = off_px(links, found)
    normalised = np.einsum("ki,kij,kj->k", off, links.information, off) / 2
    assert 0.4 < np.median(normalised) / 0.693 < 2.0
    same = np.linalg.eigvalsh(links.information)
    assert (same > 0).all()


@pytest.mark.parametrize("name", ["finer", "rolled by 10 degrees", "of another frame size"])
def test_a_displaced_unlike_neighbour_is_found(workshop: Any, name: str) -> None:
    found = pair(workshop, *cameras(workshop, UNLIKE[name]), (1.1, -1.4))
    links = link_neighbours(TASK, found)
    assert links.coarse_px is not None
    off = off_px(links, found, (1.1, -1.4))
    assert np.hypot(*np.median(off, axis=0)) < 0.03
    assert (np.hypot(*off.T) < 0.3).mean() > 0.8


def test_neighbours_that_show_different_things_are_unmatched(workshop: Any) -> None:
    found = pair(workshop, *cameras(workshop, UNLIKE["rolled by 10 degrees"]), (300.0, 200.0))
    assert link_neighbours(TASK, found).unmatched


@pytest.mark.parametrize("degrees", [5.0, 30.0])
def test_an_overlap_without_room_for_a_patch_is_no_sign_of_a_displaced_camera(workshop: Any, degrees: float) -> None:
    one = workshop.camera((0.0, 0.0), size_px=SIZE)
    other = workshop.camera((48.0, 0.0), size_px=SIZE, angle_rad=np.radians(degrees))
    reach = max(other.view_mm()[0][0] * -1 + 48.0, 0.0)
    other = workshop.camera((24.0 + reach - 1.5, 0.0), size_px=SIZE, angle_rad=np.radians(degrees))
    links = link_neighbours(TASK, pair(workshop, one, other))
    assert not len(links.a_px)
    assert not links.unmatched


def exposed(workshop: Any, camera: Camera, ratio: float, seed: int) -> PreparedFrame:
    """A frame of a board with bright spots that saturate at ratio 1, by a camera with a black level of 2."""
    waves = workshop.waves(11, finest=0.6, coarsest=12.0)
    light = 2.2 * np.exp(waves.seen_by(camera, lambda at: at).astype(np.float64) / 36)
    noise = np.random.default_rng(seed).normal(0, 1.0, light.shape)
    return PreparedFrame(np.clip(np.rint(light * ratio + 2 + noise), 0, 255).astype(np.uint8))


@pytest.mark.parametrize("darker", [0, 1])
@pytest.mark.parametrize("ratio", [0.4, 0.06])
def test_a_saturated_and_a_dark_frame_are_linked_where_both_show_the_board(
    workshop: Any, ratio: float, darker: int
) -> None:
    one, other = cameras(workshop, {})
    ratios = (ratio, 1.0) if darker == 0 else (1.0, ratio)
    first, second = exposed(workshop, one, ratios[0], 1), exposed(workshop, other, ratios[1], 1)
    found = FramePair(first, second, one, other, AT)
    bright = found.b.grey if darker == 0 else found.a.grey
    assert (bright == 255).mean() > 0.01, "the brighter frame is saturated in places"
    links = link_neighbours(TASK, found)
    assert len(links.a_px) >= 20
    off = off_px(links, found)
    assert np.hypot(*np.median(off, axis=0)) < 0.05
    assert np.sqrt(np.mean(off**2)) < 0.15
