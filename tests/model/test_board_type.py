from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vaoi_station.model import BoardType, Fiducial


def board(**change: Any) -> BoardType:
    return BoardType.model_validate({"name": "b"} | change)


def component(**change: Any) -> dict[str, Any]:
    return {"ref": "U1", "center": [10, 20], "width": 4, "height": 2} | change


def fiducial(**change: Any) -> dict[str, Any]:
    return {"name": "F1", "x": 5, "y": 5, "diameter": 1} | change


@pytest.mark.parametrize(
    ("y_axis", "side", "mirrors"),
    [("up", "top", True), ("down", "top", False), ("up", "bottom", False), ("down", "bottom", True)],
)
def test_handedness_follows_from_axis_and_side_alone(y_axis: str, side: str, mirrors: bool) -> None:
    assert board(y_axis=y_axis, side=side).mirrors is mirrors


def test_the_origin_of_the_cad_system_is_kept_and_changes_nothing_else() -> None:
    with_origin, without = (board(components=[component(**change)]) for change in ({"origin": [9, 20]}, {}))
    assert with_origin.model_dump(exclude_none=True)["components"][0]["origin"] == (9, 20)
    np.testing.assert_array_equal(
        with_origin.footprint(with_origin.components[0]), without.footprint(without.components[0])
    )
    with pytest.raises(ValidationError, match=r"the origin of component 'U1' is at \(20000, 0\) mm, must be within"):
        board(components=[component(origin=[20_000, 0])])


@pytest.mark.parametrize("y_axis", ["up", "down"])
@pytest.mark.parametrize("side", ["top", "bottom"])
def test_rotation_is_counter_clockwise_with_cad_up_shown_up(y_axis: str, side: str) -> None:
    up = 1 if y_axis == "up" else -1
    turned = board(y_axis=y_axis, side=side, components=[component(rotation=30)])
    straight = board(y_axis=y_axis, side=side, components=[component()])
    right = straight.footprint(straight.components[0])[1:3].mean(0) - (10, 20)
    after = turned.footprint(turned.components[0])[1:3].mean(0) - (10, 20)
    np.testing.assert_allclose(right, (2, 0), atol=1e-12)
    np.testing.assert_allclose(after, (2 * math.cos(math.pi / 6), up * 1.0), atol=1e-12)


@given(st.floats(-720, 720), st.floats(0.1, 50), st.floats(0.1, 50))
def test_a_footprint_keeps_centre_and_sides(rotation: float, width: float, height: float) -> None:
    b = board(components=[component(rotation=rotation, width=width, height=height)])
    corners = b.footprint(b.components[0])
    np.testing.assert_allclose(corners.mean(0), (10, 20), atol=1e-9)
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    np.testing.assert_allclose(sides, (width, height, width, height), rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "a\nb"}, "name"),
        ({"name": ""}, "name"),
        ({"components": [component(ref="U\x001")]}, "ref"),
        ({"outline": [[0, 0]]}, "outline has one point"),
        ({"outline": [[0, 0], [10, 0]]}, "outline has no area"),
        ({"outline": [[0, 0], [10, 10], [10, 0], [0, 10]]}, "crosses itself: its edges from corners 0 and 2"),
        ({"outline": [[0, 0], [4, 4]], "fiducials": [fiducial()]}, r"fiducial 'F1' at \(5.0, 5.0\) lies outside"),
        ({"components": [component(), component()]}, "components contains 'U1' twice; names must be unique"),
        ({"fiducials": [fiducial(), fiducial(x=9)]}, "fiducials contains 'F1' twice"),
        ({"fiducials": [fiducial(), fiducial(name="F2")]}, "'F2' is at the place of another fiducial"),
        ({"fiducials": [fiducial(diameter=0.04)]}, "diameter 0.04 mm, must be 0.05 to 50 mm"),
        ({"components": [component(width=2001)]}, "2001.0×2.0 mm, must be 0.01 to 2000 mm"),
        ({"fixture_marks": [{"x": 1, "y": 2}]}, "fixture_mark is missing"),
        ({"fiducials": [fiducial(name=f"F{n}", x=n) for n in range(1001)]}, "1001 entries, the limit is 1000"),
    ],
)
def test_invalid_board_types_are_refused_with_the_value(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        board(**change)


HOLE = [[1, 1], [2, 1], [2, 2]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cut_outs": [HOLE]}, "cut_outs are given, but outline is missing"),
        ({"outline": [[0, 0], [9, 9]], "cut_outs": [HOLE, HOLE[:2]]}, "cut_outs.1 has 2 corners"),
        ({"outline": [[3, 3], [9, 9]], "cut_outs": [HOLE]}, "cut_outs.0 lies outside the outline"),
        ({"outline": [[0, 0], [9, 9]], "cut_outs": [HOLE] * 501}, "cut_outs has 501 entries, the limit is 500"),
    ],
)
def test_wrong_cut_outs_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        board(**change)


def test_fiducials_of_boards_need_components_and_unambiguous_addresses() -> None:
    of_board = {"fiducials": [fiducial(panel="A")], "components": [component(panel="A")]}
    assert board(**of_board).board_fiducials == {"A": (0,)}
    assert (
        board(**of_board).filmed_digest()
        != board(fiducials=[fiducial()], components=of_board["components"]).filmed_digest()
    )
    with pytest.raises(ValidationError, match="'F1' belongs to position 'B' of the panel, which has no components"):
        board(fiducials=[fiducial(name="F1", panel="B")], components=[component(panel="A")])
    with pytest.raises(ValidationError, match="'A/U9' belongs to no position of the panel, but its name begins"):
        board(fiducials=[fiducial(panel="A")], components=[component(panel="A"), component(ref="A/U9")])


def test_the_digest_of_what_is_filmed_stays_when_a_board_type_is_approved() -> None:
    before = board(fiducials=[fiducial()], components=[component()])
    approved = board(
        state="approved",
        revision="B",
        fiducials=[fiducial(kind="local", found_by="name", components=["U1"])],
        components=[component(size_from="file", package="QFP")],
    )
    assert approved.filmed_digest() == before.filmed_digest()
    assert board(fiducials=[fiducial(x=6)], components=[component()]).filmed_digest() != before.filmed_digest()
    older = json.loads((Path(__file__).parents[1] / "fuzz" / "corpus" / "board" / "tiny").read_text())
    # The digest of the whole document in the version before the keys were added.
    assert board(**older).filmed_digest() == "42fe5793c1d34326"
    slow = BoardType.model_validate({"name": "b", "line": {"speed_mm_s": 50.0}})
    assert slow.filmed_digest() == "ebfebb527a91fff1"
    by_belt = BoardType.model_validate({"name": "b", "line": {"speed_mm_s": 50.0, "pacing": "encoder"}})
    assert by_belt.filmed_digest() != slow.filmed_digest()


def mark(name: str, x: float, y: float, panel: str | int | None = None, **of: object) -> Fiducial:
    return Fiducial.model_validate({"name": name, "x": x, "y": y, "diameter": 1.0, "panel": panel} | of)


@pytest.mark.parametrize("panel", ["", "A/B", "x" * 41, "a\n"])
def test_a_position_that_addresses_cannot_contain_is_refused(panel: str) -> None:
    with pytest.raises(ValidationError):
        mark("a", 0, 0, panel)
