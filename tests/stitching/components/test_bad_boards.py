"""Reasons for boards of a panel that their fiducials do not place."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.model import BoardType, ReasonCode
from vaoi_station.stitching.components.bad_boards import board_reasons, look_of, read_bad_marks
from vaoi_station.stitching.components.places import OwnPlace
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


def test_marks_that_cannot_be_compared_have_no_look() -> None:
    assert look_of(drawn(200, 60), MIDDLE, 5.0) is None, "too small"
    assert look_of(drawn(200, 60), np.array([6.0, 30.0]), SIZE_PX) is None, "cut off"
    assert look_of(drawn(255, 254, noise=0.0), MIDDLE, SIZE_PX) is None, "saturated"
    assert look_of(drawn(3, 4, noise=0.0), MIDDLE, SIZE_PX) is None, "no light"


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


GOOD = OwnPlace(("F1", "F2"), sigma_mm=0.001, sigma_turn_rad=1e-5, off_mm=0.002, matrix=np.eye(3))
LOST = replace(GOOD, fiducials=(), lost=("F1", "F2"), matrix=None, sigma_mm=0.15, refusal="F1, F2 was not found")


def test_boards_that_follow_the_panel_are_named_with_their_standard_deviation() -> None:
    ((code, text),) = (
        (r.code, r.message) for r in board_reasons({"1": GOOD} | {str(n): LOST for n in range(2, 8)}, 20.0)
    )
    assert code == ReasonCode.BOARD_UNPLACED
    assert text.startswith("6 of 7 boards of the panel follow the panel, with ± 0.15 mm")
    assert "2: F1, F2 was not found" in text
    assert "and 2 more" in text
