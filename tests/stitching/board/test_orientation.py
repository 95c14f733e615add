"""The orientation from painted pictures of a board, as placed and turned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.board.outline import (
    Orientation,
    compare_orientations,
    measure_outline_contrast,
    outline_pieces,
    outline_polygons,
    straight_pieces,
)
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

OUTLINE = [[0.0, 0.0], [34.0, 22.0]]
PARTS: list[dict[str, Any]] = [
    {"ref": f"U{k}", "center": [x, y], "width": w, "height": h}
    for k, (x, y, w, h) in enumerate([(8, 6, 8, 5), (24, 8, 5, 8), (12, 16, 6, 4), (27, 16, 7, 5)])
]
PLACED = np.array([[1.0, 0, -16.0], [0, 1, -10.0], [0, 0, 1]])
TURNED = np.array([[-1.0, 0, 13.0], [0, -1, 9.0], [0, 0, 1]])
"""About the middle of the fiducials, which is not the middle of the board."""
STILL = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))


def board(**keys: Any) -> BoardType:
    return BoardType.model_validate({"name": "b", "y_axis": "down", **keys})


def scene(workshop: Any, paint: list[tuple[list[list[float]], float]], belt: float = 20.0) -> Scene:
    """One frame of all of a board at rest, painted from rectangles in CAD coordinates."""
    camera = workshop.camera((0.0, 0.0), size_px=(440, 320))
    y, x = np.mgrid[:320, :440].astype(float)
    cad = apply(np.linalg.inv(PLACED), camera.ground(np.stack([x, y], -1).reshape(-1, 2))).reshape(320, 440, 2)
    picture = np.full((320, 440), belt)
    for corners, grey in paint:
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        picture[((cad >= low) & (cad <= high)).all(-1)] = grey
    picture += np.random.default_rng(0).normal(0, 2, picture.shape)
    frame = PreparedFrame(workshop.digitised(picture))
    return Scene((camera,), ((0, 0),), lambda key: frame)


def footprints(grey: float) -> list[tuple[list[list[float]], float]]:
    out = []
    for part in PARTS:
        (x, y), w, h = part["center"], part["width"], part["height"]
        out.append(([[x - w / 2, y - h / 2], [x + w / 2, y + h / 2]], grey))
    return out


@pytest.mark.parametrize("grey", [80.0, 5.0])
def test_the_outline_decides_the_orientation(workshop: Any, grey: float) -> None:
    seen = scene(workshop, [(OUTLINE, grey)], belt=40.0)
    right = compare_orientations(board(outline=OUTLINE), PLACED, TURNED, seen, STILL)
    wrong = compare_orientations(board(outline=OUTLINE), TURNED, PLACED, seen, STILL)
    assert right is not None
    assert wrong is not None
    assert (right.evidence, right.confirms, right.contradicts) == ("outline", True, False)
    assert (wrong.confirms, wrong.contradicts) == (False, True)
    assert right.as_placed == pytest.approx(abs(grey - 40), abs=4)
    assert right.turned < 4


def test_components_decide_where_the_outline_does_not(workshop: Any) -> None:
    """Belt and board are equally bright."""
    seen = scene(workshop, [(OUTLINE, 60.0), *footprints(150.0)], belt=60.0)
    kind = board(outline=OUTLINE, components=PARTS)
    right = compare_orientations(kind, PLACED, TURNED, seen, STILL)
    assert right is not None
    assert (right.evidence, right.confirms) == ("components", True)
    wrong = compare_orientations(kind, TURNED, PLACED, seen, STILL)
    assert wrong is not None
    assert wrong.contradicts


def test_a_blank_picture_decides_nothing(workshop: Any) -> None:
    found = compare_orientations(
        board(outline=OUTLINE, components=PARTS), PLACED, TURNED, scene(workshop, [], 60.0), STILL
    )
    assert found is not None
    assert not found.confirms
    assert not found.contradicts


def test_without_outline_and_parts_there_is_nothing_to_compare(workshop: Any) -> None:
    fiducials = [{"name": n, "x": x, "y": x, "diameter": 1} for n, x in (("A", 1), ("B", 9))]
    kind = board(fiducials=fiducials)
    seen = scene(workshop, [(OUTLINE, 80.0)])
    assert compare_orientations(kind, PLACED, TURNED, seen, STILL) is None
    assert measure_outline_contrast(kind, PLACED, seen, STILL) is None


def test_a_symmetric_outline_is_not_compared(workshop: Any) -> None:
    about_middle = np.array([[-1.0, 0, 18.0], [0, -1, 12.0], [0, 0, 1]])
    assert (
        compare_orientations(board(outline=OUTLINE), PLACED, about_middle, scene(workshop, [(OUTLINE, 80.0)]), STILL)
        is None
    )


def shifted(x_mm: float) -> NDArray[np.float64]:
    return np.asarray(np.array([[1.0, 0, x_mm], [0, 1, x_mm], [0, 0, 1]]) @ PLACED)


def test_the_outline_is_visible_where_it_is_and_nowhere_else(workshop: Any) -> None:
    seen = scene(workshop, [(OUTLINE, 80.0)])
    here = measure_outline_contrast(board(outline=OUTLINE), PLACED, seen, STILL)
    assert here is not None
    assert here.visible
    assert here.contrast == pytest.approx(60, abs=3)
    assert here.pieces >= 20
    off = measure_outline_contrast(board(outline=OUTLINE), shifted(1.5), seen, STILL)
    assert off is not None
    assert not off.visible


def test_polygons_count_as_outlines(workshop: Any) -> None:
    corners = [[0.0, 0.0], [34.0, 0.0], [34.0, 22.0], [0.0, 22.0]]
    seen = scene(workshop, [(OUTLINE, 80.0)])
    assert measure_outline_contrast(board(outline=corners), PLACED, seen, STILL) == measure_outline_contrast(
        board(outline=OUTLINE), PLACED, seen, STILL
    )


def test_a_board_out_of_view_is_not_compared(workshop: Any) -> None:
    away = Motion(np.zeros(1), np.array([[500.0, 0.0]]), np.zeros(2))
    seen = scene(workshop, [(OUTLINE, 80.0)])
    assert measure_outline_contrast(board(outline=OUTLINE), PLACED, seen, away) is None
    assert compare_orientations(board(outline=OUTLINE), PLACED, TURNED, seen, away) is None


@pytest.mark.parametrize("w", [8.0, 30.0, 400.0])
def test_few_pieces_are_all_taken_and_many_are_thinned_evenly(w: float) -> None:
    kind = board(outline=[(0.0, 0.0), (w, w)])
    every, chosen = straight_pieces(outline_polygons(kind), kind.mm_per_unit), outline_pieces(kind)
    assert len(chosen) == min(len(every), 48)
    assert (chosen[0] == every[0]).all()
    assert (chosen[-1] == every[-1]).all()


@given(st.floats(1, 90), st.floats(1, 90), st.sampled_from([1.0, 25.4]))
def test_pieces_follow_the_outline_without_gaps(w: float, h: float, mm_per_unit: float) -> None:
    (polygon,) = outline_polygons(board(outline=[[0.0, 0.0], [w, h]]))
    pieces = straight_pieces([polygon], mm_per_unit)
    np.testing.assert_allclose(pieces[1:, 0], pieces[:-1, 1], atol=1e-9)
    np.testing.assert_allclose(pieces[0, 0], pieces[-1, 1], atol=1e-9)
    length = np.hypot(*(pieces[:, 1] - pieces[:, 0]).T)
    assert length.sum() == pytest.approx(2 * (w + h))
    assert (length * mm_per_unit).max() < 8.0, "an edge below twice 4 mm stays whole"


def test_no_outline_has_no_pieces() -> None:
    assert outline_polygons(BoardType.model_validate({"name": "b", "fiducials": []})) == []
    assert straight_pieces([], 1.0).shape == (0, 2, 2)


@pytest.mark.parametrize(
    ("evidence", "placed", "turned", "confirms", "contradicts"),
    [
        ("outline", 30.0, 2.0, True, False),
        ("outline", 2.0, 30.0, False, True),
        ("outline", 30.0, 25.0, False, False),
        ("outline", 4.0, 0.1, False, False),
        ("components", 9.0, 0.1, False, False),
        ("components", 30.0, 11.0, True, False),
    ],
)
def test_an_orientation_needs_contrast_and_a_clear_factor(
    evidence: str, placed: float, turned: float, confirms: bool, contradicts: bool
) -> None:
    found = Orientation(evidence, placed, turned)
    assert (found.confirms, found.contradicts) == (confirms, contradicts)
