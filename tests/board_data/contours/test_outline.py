"""Outlines of drawings that are not tidy: the same contours as of the tidy one."""

from __future__ import annotations

import math
import random
import subprocess
import sys
from itertools import pairwise

import pytest
import shapely
import shapely.ops
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.board_data.contours import Contours, arc_points, circle_points, find_contours
from vaoi_station.board_data.contours.graph import JOIN_MM
from vaoi_station.board_data.design import XY, rotated

Piece = list[XY]
CORNERS = [(0.0, 0.0), (50.0, 0.0), (50.0, 40.0), (0.0, 40.0)]
RECTANGLE: list[Piece] = [[a, b] for a, b in zip(CORNERS, CORNERS[1:] + CORNERS[:1], strict=True)]
HOLE: Piece = circle_points((20.0, 20.0), 3.0)
SLOT: list[Piece] = [[(23, 15), (27, 15)], [(27, 15), (27, 25)], [(27, 25), (23, 25)], [(23, 25), (23, 15)]]


def found(*pieces: Piece) -> Contours:
    return find_contours(pieces, "Edge.Cuts")


def codes(contours: Contours) -> set[str]:
    return {note.code for note in contours.notes}


def assert_is(contour: tuple[XY, ...], expected: list[XY] | Piece, within_mm: float = 2 * JOIN_MM) -> None:
    """A contour lies nowhere farther from the expected one, and encloses the same."""
    one, other = shapely.Polygon(contour), shapely.Polygon(expected)
    assert one.is_valid
    assert one.exterior.is_ccw
    assert shapely.hausdorff_distance(one.exterior, other.exterior, densify=0.01) <= within_mm
    assert one.symmetric_difference(other).area <= within_mm * other.length


@pytest.mark.parametrize(
    ("pieces", "reason"),
    [
        ([[(0, 0), (-2, 0)], [(60, 0), (70, 5)]], "2 close no contour at (0, 0), (60, 0)"),
        ([[(25, -5), (25, 45)]], "1 divide a board or cut-out at (25, -5)"),
        ([[(50, 10), (50, 20)]], "1 repeat others at (50, 10)"),
        ([[(7, 7), (7, 7)]], "1 within 0.02 mm at (7, 7)"),
        ([[(9, k), (11, k)] for k in range(1, 8)], "7 close no contour at (9, 1), (9, 2), (9, 3), (9, 4) and 3 more"),
    ],
)
def test_lines_that_were_left_out_are_said_with_place_and_reason(pieces: list[Piece], reason: str) -> None:
    (note,) = found(*RECTANGLE, *pieces).notes
    assert note == f"lines of Edge.Cuts were left out: {reason}."
    assert (note.code, note.values["count"]) == ("lines-left-out", str(len(pieces)))


def test_lines_that_cross_beyond_their_corners_make_a_contour_and_are_said() -> None:
    contours = found([(-1, 0), (51, 0)], [(50, -1), (50, 41)], [(51, 40), (-1, 40)], [(0, 41), (0, -1)])
    assert_is(contours.outline, CORNERS)
    assert "4 in part, beyond their contour" in contours.notes[0]


@pytest.mark.parametrize(("gap_mm", "said"), [(0.01, False), (0.0199, False), (0.05, True), (0.1, True), (1.0, True)])
def test_gaps_at_corners_are_closed_and_said_above_the_tolerance(gap_mm: float, said: bool) -> None:
    short = [[(a[0] + gap_mm * (b[0] - a[0]) / math.dist(a, b), a[1] + gap_mm * (b[1] - a[1]) / math.dist(a, b)), b]
             for a, b in RECTANGLE]  # fmt: skip
    contours = found(*short, HOLE)
    assert_is(contours.outline, CORNERS, within_mm=gap_mm + JOIN_MM)
    assert len(contours.others) == 1
    assert codes(contours) == ({"outline-gaps-closed"} if said else set())


@pytest.mark.parametrize(
    ("pieces", "areas"),
    [
        ([circle_points((10, 10), 2), circle_points((14, 10), 2)], [12.2, 12.2]),
        ([[(5, 5), (9, 5), (9, 9), (5, 9), (5, 5)], [(9, 6), (12, 6), (12, 8), (9, 8), (9, 6)]], [22]),
        ([circle_points((10, 10), 2), circle_points((12, 10), 2)], [19.7]),
        ([circle_points((2, 20), 2)], [12.2]),
        (SLOT, [40]),
        ([*SLOT, [(25, -2), (25, 42)]], [40]),
        ([*SLOT, [(25, 0), (25, 15)], [(25, 25), (25, 40)]], [40]),
        ([*SLOT, [(23, 20), (27, 20)]], [40]),
        ([*SLOT, *SLOT, [(27.005, 15), (27, 24.99)]], [40]),
    ],
    ids=[
        "touch at a point",
        "touch along a side",
        "overlap",
        "touches the outline",
        "plain",
        "crossed by a V-score",
        "reached by V-scores",
        "divided",
        "repeated",
    ],
)
def test_cut_outs_that_touch_or_are_crossed(pieces: list[Piece], areas: list[float]) -> None:
    contours = found(*RECTANGLE, *pieces)
    assert_is(contours.outline, CORNERS)
    assert [shapely.Polygon(c).area for c in contours.others] == pytest.approx(areas, rel=0.02)


def test_of_several_boards_the_largest_is_the_outline_and_the_others_follow() -> None:
    second = [[(x + 60, y / 2) for x, y in piece] for piece in RECTANGLE]
    contours = found(*second, *RECTANGLE, HOLE)
    assert_is(contours.outline, CORNERS)
    assert [round(shapely.Polygon(c).area) for c in contours.others] == [1000, 28]


def test_coordinates_that_are_not_finite_are_refused() -> None:
    for wrong in (float("nan"), float("-inf"), 1e300):
        with pytest.raises(ValueError, match="coordinates"):
            found([(0, 0), (wrong, 1)])
    assert found() == Contours()


def profiled(pieces: list[Piece]) -> tuple[Contours, int]:
    """The contours of a drawing, and how many functions were called for them."""
    called = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal called
        called += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        contours = find_contours(pieces, "")
    finally:
        sys.setprofile(None)
    return contours, called


def test_the_effort_of_a_drawing_grows_with_its_lines_not_with_their_square() -> None:
    """Counted as calls of functions, which depend on no machine. Half of the second drawing are holes."""
    find_contours(RECTANGLE, "")  # shapely is loaded
    calls: dict[int, list[int]] = {}
    for count in (1_000, 8_000):
        corners = [(200 * math.cos(a), 200 * math.sin(a)) for a in (2 * math.pi * k / count for k in range(count))]
        ring = [[a, b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        side = round(math.sqrt(count / 16))
        holes = [
            circle_points((5.0 * (i - side / 2), 5.0 * (j - side / 2)), 1) for i in range(side) for j in range(side)
        ]
        short = [[a, b] for hole in holes for a, b in pairwise(hole)]
        for pieces, others in ((ring + ring, 0), (ring[1:] + short + short[:1], len(holes))):
            random.Random(1).shuffle(pieces)
            contours, called = profiled(pieces)
            assert shapely.Polygon(contours.outline).area == pytest.approx(math.pi * 200**2, rel=1e-3)
            assert len(contours.others) == others
            calls.setdefault(count, []).append(called)
    assert all(many < 12 * few for few, many in zip(calls[1_000], calls[8_000], strict=True)), calls


def test_shapely_is_loaded_by_no_command_that_reads_no_drawing() -> None:
    check = "import sys, vaoi_station.cli, vaoi_station.board_data; sys.exit('shapely' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@st.composite
def boards(draw: st.DrawFn) -> tuple[list[Piece], list[XY], list[list[XY]]]:
    """The pieces of a tidy drawing, its outline, and its cut-outs."""
    width, height = draw(st.floats(20, 200)), draw(st.floats(20, 200))
    radius, notch = draw(st.sampled_from([0.0, 1.0, 5.0])), draw(st.booleans())
    corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
    if notch:
        corners[2:3] = [(width, 0.6 * height), (0.7 * width, 0.6 * height), (0.7 * width, height)]
    pieces: list[Piece] = [[a, b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    if radius:
        pieces[0] = [(radius, 0.0), pieces[0][1]]
        pieces[-1] = [pieces[-1][0], (0.0, radius)]
        pieces.append(arc_points((0.0, radius), (radius, 0.0), (radius, radius), clockwise=False))
    outline = shapely.get_coordinates(shapely.ops.linemerge(pieces)).tolist()
    holes = [
        circle_points((x * width, y * height), draw(st.floats(0.2, 2.0)))
        for x, y in ((0.2, 0.2), (0.5, 0.25), (0.2, 0.5))[: draw(st.integers(0, 3))]
    ]
    turn, shift = draw(st.floats(0, 360)), (draw(st.floats(-300, 300)), draw(st.floats(-300, 300)))

    def at(piece: Piece) -> Piece:
        return [(x + shift[0], y + shift[1]) for x, y in (rotated(p, turn) for p in piece)]

    return [at(p) for p in [*pieces, *holes]], at(outline), [at(hole) for hole in holes]


def between(a: XY, b: XY, t: float) -> XY:
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])


def bridges(line: Piece, outline: list[XY]) -> bool:
    """Tell whether a line leaves the board and reaches it again: what it encloses may or may not be board."""
    inside = shapely.Polygon(outline).buffer(2 * JOIN_MM).intersection(shapely.LineString(line))
    return str(inside.geom_type) != "LineString"


def untidy(pieces: list[Piece], outline: list[XY], r: random.Random) -> list[Piece]:
    """Split, reverse and repeat pieces; add a stub or a V-score, and lines without length; shift ends a little."""
    found: list[Piece] = []
    for piece in pieces:
        at = sorted(r.sample(range(1, len(piece)), min(len(piece) - 1, r.randrange(3)))) if len(piece) > 2 else []
        parts = [piece[a : b + 1] for a, b in zip([0, *at], [*at, len(piece) - 1], strict=True) if b > a]
        for part in parts:
            if len(part) == 2 and r.random() < 0.6:
                middle = between(part[0], part[1], r.uniform(0.01, 0.99))
                found += [[part[0], middle], [middle, part[1]]]
            else:
                found.append(part)
    # A stub and a V-score, or two stubs, may enclose a triangle at the edge of the board: then there is no one truth.
    has_v_score, has_stub = r.random() < 0.5, False
    for piece in r.sample(found, min(len(found), 5)):
        a, b = piece[0], piece[1]
        kind = r.choice((0, 1, 2, 4) if has_v_score or has_stub else (0, 1, 2, 3, 4))
        has_stub |= kind == 3
        if kind == 0:
            found.append(piece[::-1])
        elif kind == 1:
            found.append([between(a, b, 0.2), between(a, b, 0.7)])
        elif kind == 2:
            # With the shift of ends below, points of two copies are less than JOIN_MM from each other.
            found.append([(x + r.uniform(-0.006, 0.006), y + r.uniform(-0.006, 0.006)) for x, y in piece])
        elif kind == 3:
            x, y = between(a, b, 0.5)
            stub = [(x, y), (x + r.uniform(-2, 2), y + r.uniform(-2, 2))]
            found += [] if bridges(stub, outline) else [stub]
        else:
            found.append([a, a])
    if has_v_score:
        (x0, y0), (x1, y1) = (between(a, b, r.uniform(0.3, 0.7)) for a, b in r.sample(list(pairwise(outline)), 2))
        score = [(2 * x0 - x1, 2 * y0 - y1), (2 * x1 - x0, 2 * y1 - y0)]
        found += [] if bridges(score, outline) else [score]
    shaken = []
    for piece in found:
        ends = [(x + r.uniform(-0.006, 0.006), y + r.uniform(-0.006, 0.006)) for x, y in (piece[0], piece[-1])]
        moved = [ends[0], *piece[1:-1], ends[1]] if r.random() < 0.3 else piece
        shaken.append(moved[::-1] if r.random() < 0.5 else moved)
    r.shuffle(shaken)
    return shaken


@settings(max_examples=100, deadline=None)
@given(boards(), st.integers(0, 2**32))
def test_an_untidy_drawing_has_the_contours_of_the_tidy_one(
    board: tuple[list[Piece], list[XY], list[list[XY]]], seed: int
) -> None:
    pieces, outline, holes = board
    contours = find_contours(untidy(pieces, outline, random.Random(seed)), "")
    assert_is(contours.outline, outline, within_mm=4 * JOIN_MM)
    assert len(contours.others) == len(holes)
    for hole in holes:
        center = shapely.Polygon(hole).centroid
        (cut_out,) = (c for c in contours.others if shapely.Polygon(c).contains(center))
        assert_is(cut_out, hole, within_mm=4 * JOIN_MM)
