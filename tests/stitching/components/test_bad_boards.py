"""Reasons for boards of a panel that their fiducials do not place."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.model import BoardType
from vaoi_station.stitching.components.bad_boards import look_of, read_bad_marks
from vaoi_station.stitching.matching.frames import Scene

SIZE_PX, MIDDLE = 16.0, np.array([40.3, 29.6])


def drawn(disc: float, around: float, half: float | None = None, noise: float = 1.0) -> NDArray[np.uint8]:
    """A frame of 80 × 60 px with a disc; its right half may be another grey."""
    y, x = np.mgrid[:60, :80]
    inside = np.hypot(x - MIDDLE[0], y - MIDDLE[1]) < SIZE_PX / 2
    grey = np.where(inside, disc, around)
    if half is not None:
        grey = np.where(inside & (x > MIDDLE[0]), half, grey)
    return np.clip(grey + np.random.default_rng(1).normal(0, noise, grey.shape), 0, 255).astype(np.uint8)


def look(grey: NDArray[np.uint8], size_px: float = SIZE_PX) -> str | None:
    shares = look_of(grey, MIDDLE, size_px)
    return None if shares is None else max(shares, key=lambda name: shares[name])


@settings(max_examples=30, deadline=None)
@given(st.integers(20, 200), st.floats(0.3, 1.8))
def test_the_look_does_not_depend_on_the_light(around: int, light: float) -> None:
    around_lit = min(max(around * light, 12.0), 180.0)
    assert look(drawn(min(2.2 * around_lit, 255), around_lit, noise=0.3)) == "light"
    assert look(drawn(around_lit / 3, around_lit, noise=0.3)) == "dark"
    assert look(drawn(around_lit, around_lit, noise=0.3)) == "blank"


def marked(greys: list[NDArray[np.uint8]], workshop: Any, **mark: Any) -> dict[str, Any]:
    """State of board A by its mark in rows of one camera in which the panel does not move."""
    camera = workshop.camera(size_px=(80, 60))
    center = camera.row_from_image(MIDDLE[None])[0].tolist()
    known = {"name": "M", "x": center[0], "y": center[1], "diameter": SIZE_PX / camera.px_per_mm, "kind": "bad-board"}
    parts = [{"ref": "U1", "panel": "A", "center": center, "width": 1, "height": 1}]
    data = {"name": "b", "components": parts, "other_marks": [known | {"panel": "A", "bad": "dark"} | mark]}
    keys = tuple((0, j) for j in range(len(greys)))
    scene = Scene((camera,), keys, lambda key: SimpleNamespace(grey=greys[key[1]]))  # type: ignore[arg-type,return-value]
    frames = scene.index(np.repeat(np.eye(3)[None], len(greys), 0))
    return read_bad_marks(BoardType.model_validate(data), {}, frames)


@pytest.mark.parametrize(
    ("greys", "mark", "state"),
    [
        ([drawn(12, 70)] * 2, {}, "bad"),
        ([drawn(70, 70)] * 2, {}, "good"),
        ([drawn(205, 70)] * 2, {}, "doubtful"),
        ([drawn(205, 70)] * 2, {"bad": "light"}, "bad"),
        ([drawn(70, 70, half=12)] * 2, {}, "doubtful"),
        ([drawn(12, 70), drawn(70, 70)], {}, "doubtful"),
        ([drawn(3, 3)] * 2, {}, "doubtful"),
        ([drawn(3, 3), drawn(12, 70)], {}, "bad"),
    ],
)
def test_a_board_is_bad_only_if_every_frame_shows_it(
    greys: list[NDArray[np.uint8]], mark: dict[str, Any], state: str, workshop: Any
) -> None:
    found = marked(greys, workshop, **mark)
    assert found["A"].state == state
    assert found["A"].marks[0].frames == sum(int(grey.max()) > 40 for grey in greys)
