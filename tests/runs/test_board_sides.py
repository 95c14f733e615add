"""Runs of top and bottom are one board; what is missing or contradicts is said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import Camera, Lens, Projective, Similarity, System
from vaoi_station.model import BoardCode, BoardType, Reason, Status
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.board_sides import BoardDocument, BoardSide, code_at_place, join_sides, parts_of
from vaoi_station.stitching.board.board_plane import board_plane, expected_angle, turned_by_flip
from vaoi_station.stitching.expectation import Expectation


def side(name: str, turn_deg: float = 0.0, **fields: Any) -> BoardSide:
    """Return a side as it was filmed: the bottom is seen mirrored, flipped about the tester's x axis, then turned."""
    turn, bottom = np.radians(turn_deg), name == "bottom"
    matrix = Similarity.of(1.0, turn, (9, 9), System.TESTER, System.CAD, mirrored=bottom).matrix
    known = {
        "side": name, "run": name, "address": f"/api/v1/runs/{name}", "board_type": f"b-{name}", "verdict": "ok",
        "started": "2026-11-29T10:20:00.000Z" if bottom else "2026-11-29T10:00:00.000Z", "components": 3,
        "extent_mm": ((0.0, 0.0), (60.0, 40.0)), "cad_matrix": tuple(map(tuple, matrix.tolist())), "turn_certain": True,
    }  # fmt: skip
    return BoardSide.model_validate({**known, **fields})


def codes(document: BoardDocument) -> list[str]:
    return [reason.code for reason in document.reasons]


def joined(*sides: BoardSide, within_s: float = 3600.0) -> BoardDocument:
    return join_sides("SN-1", sides, within_s)


def parts(*refs: str) -> Any:
    listed = [{"ref": ref, "center": (n, 0), "width": 1, "height": 1} for n, ref in enumerate(refs)]
    return parts_of(BoardType.model_validate({"name": "b", "components": listed}))


@pytest.mark.parametrize(("turn_deg", "axis", "axis_deg"), [(0.0, "x", 0.0), (180.0, "y", 90.0), (3.0, "x", 1.5)])
def test_two_sides_that_agree_are_one_board_with_the_axis_of_its_flip(
    turn_deg: float, axis: str, axis_deg: float
) -> None:
    found = joined(side("bottom", turn_deg), side("top"))
    assert (found.status, found.reasons, found.others) == (Status.OK, (), ())
    assert found.top is not None
    assert found.bottom is not None
    assert (found.flip, found.flip_by) == (axis, ("cad",))
    assert found.flip_axis_deg == pytest.approx(axis_deg, abs=1e-6)


def test_a_missing_side_is_said_and_why() -> None:
    assert codes(joined(side("top"))) == ["side-missing"]
    late = joined(side("bottom"), side("top"), within_s=600.0)
    assert (codes(late), late.top) == (["side-too-old"], None)
    assert [other.run for other in late.others] == ["top"]
    assert "1200 s before" in late.reasons[0].message
    assert codes(join_sides("SN-1", [side("top")], 3600.0, ("bottom",))) == ["side-coming"]
    assert codes(join_sides("SN-1", [], 3600.0, ("top",))) == ["side-coming", "side-missing"]


def test_a_board_is_not_ok_while_a_side_is_filmed_again_or_the_other_station_is_silent() -> None:
    sides = side("bottom"), side("top")
    again = join_sides("SN-1", sides, 3600.0, ("top",))
    assert (again.status, codes(again)) == (Status.DEGRADED, ["side-coming"])
    silent = join_sides("SN-1", sides, 3600.0, more=[Reason(code="other-station-silent", message="m", action="a")])
    assert (silent.status, codes(silent)) == (Status.DEGRADED, ["other-station-silent"])


def test_the_newest_run_of_a_side_counts_and_a_second_good_one_is_said() -> None:
    again = side("top", run="again", started="2026-11-29T10:10:00.000Z", verdict="degraded")
    found = joined(side("bottom"), again, side("top"))
    assert found.top is not None
    assert found.top.run == "again"
    assert (found.status, codes(found)) == (Status.DEGRADED, ["side-degraded", "side-seen-twice"])
    assert codes(joined(side("bottom"), again, side("top", verdict="failed"))) == ["side-degraded"]
    assert codes(joined(again.model_copy(update={"verdict": Status.OK}), side("top"))) == [
        "side-missing",
        "side-seen-twice",
    ]


@pytest.mark.parametrize("other", [{"board_type": "b-2"}, {"address": "http://127.0.0.1:9/api/v1/runs/2"}])
def test_two_runs_that_state_the_same_side_are_no_board(other: dict[str, Any]) -> None:
    second = side("top", run="2", started="2026-11-29T10:10:00.000Z", **other)
    assert codes(joined(second, side("top"))) == ["sides-same"]


@pytest.mark.parametrize(
    ("fields", "code", "status"),
    [
        ({"verdict": "failed"}, "side-failed", Status.FAILED),
        ({"verdict": None}, "side-failed", Status.FAILED),
        ({"verdict": "degraded"}, "side-degraded", Status.DEGRADED),
        ({"identity": "differs"}, "side-of-other-board", Status.DEGRADED),
        ({"identity": "pending"}, "side-coming", Status.DEGRADED),
        ({"revision": "B"}, "sides-other-revision", Status.DEGRADED),
        ({"extent_mm": ((0.0, 0.0), (60.0, 43.0))}, "sides-differ", Status.DEGRADED),
        ({"extent_mm": ((-60.0, 0.0), (0.0, 40.0))}, "sides-differ", Status.DEGRADED),
        ({"parts": parts("R1", "R7")}, "sides-differ", Status.DEGRADED),
        ({"cad_matrix": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))}, "sides-not-flipped", Status.DEGRADED),
        ({"turn_deg": 80.0}, "sides-not-flipped", Status.DEGRADED),
        ({"flip": "y"}, "flip-contradicts", Status.DEGRADED),
        ({"turn_certain": False}, "flip-unknown", Status.DEGRADED),
    ],
)
def test_a_side_that_contradicts_is_said(fields: dict[str, Any], code: str, status: Status) -> None:
    found = joined(side("bottom", **fields), side("top", revision="A", parts=parts("R1", "R2")))
    assert (codes(found), found.status) == ([code], status)
    assert (found.flip is None) == (code in {"sides-not-flipped", "flip-contradicts", "flip-unknown"})


def test_an_order_or_a_code_at_its_place_states_the_flip_where_fiducials_do_not() -> None:
    doubtful = {"turn_certain": False}
    ordered = joined(side("bottom", **doubtful, flip="x"), side("top", **doubtful))
    assert (ordered.reasons, ordered.flip, ordered.flip_by) == ((), "x", ("order",))
    assert joined(side("bottom", **doubtful, flip="x"), side("top")).flip_by == ("order",), (
        "one certain side shows none"
    )
    read = joined(side("bottom", **doubtful, code_at_place=True), side("top"))
    assert (read.reasons, read.flip, read.flip_by) == ((), "x", ("codes", "cad"))
    assert codes(joined(side("bottom", flip="x"), side("top", flip="y"))) == ["flip-contradicts"]


def test_sides_without_outlines_are_joined() -> None:
    found = joined(side("bottom", extent_mm=None), side("top"))
    assert found.status is Status.OK


def test_a_code_at_its_place_excludes_a_turn_unless_another_place_lies_opposite() -> None:
    def read_at(*places: tuple[float, float]) -> bool:
        board = BoardType.model_validate({
            "name": "b", "outline": [[0, 0], [60, 40]],
            "identity": {"places": [{"center": place, "width": 6, "height": 6} for place in places]},
        })  # fmt: skip
        code = BoardCode(
            text="1", symbology="qr", center=(11.0, 9.0), corners=((0, 0),) * 4, module_mm=0.2, error_correction_used=0
        )
        return code_at_place(board, IdentityDocument(state="agrees", codes=(code,)))

    assert read_at((10, 10))
    assert not read_at((10, 10), (50, 30))
    assert not read_at((30, 30))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("camera", [[[8, 0], [0, -8]], [[8, 0], [0, 8]], [[-8, 0], [0, 8]], [[0, 8], [8, 0]]])
def test_the_axis_of_an_order_is_the_one_that_the_sides_show_if_they_lie_as_expected(
    camera: Any, rotation_deg: int, axis: Any
) -> None:
    matrix = np.zeros((3, 3))
    matrix[:2, :2], matrix[2, 2] = camera, 1.0
    seen_by = Camera(320, 240, Projective(matrix, System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0), 400.0)
    upright = Expectation(angle_rad=-np.radians(rotation_deg))
    turned = turned_by_flip([seen_by], upright.angle_rad, axis)
    lying = {"top": upright, "bottom": replace(upright, angle_rad=upright.angle_rad + (np.pi if turned else 0.0))}
    sides = []
    for name, expected in lying.items():
        board = BoardType.model_validate({"name": "b", "side": name, "outline": [[0, 0], [60, 40]]})
        plane = board_plane(board, seen_by)
        angle = expected_angle(plane, seen_by, expected)
        c = plane.matrix(np.array([np.cos(angle), np.sin(angle), 0.0, 0.0]))
        sides.append(side(name, cad_matrix=tuple(map(tuple, c.tolist())), flip=axis if name == "bottom" else None))
    found = joined(*sides)
    assert (found.reasons, found.flip, found.flip_by) == ((), axis, ("order", "cad"))


def test_parts_of_inches_and_of_y_down_have_the_common_frame() -> None:
    board = BoardType.model_validate({
        "name": "b", "unit": "inch", "y_axis": "down", "side": "bottom", "outline": [[0, 0], [2, 1]],
        "components": [{"ref": "R1", "center": [1, 0.5], "width": 0.1, "height": 0.05, "rotation": 90, "panel": 2}],
    })  # fmt: skip
    found = parts_of(board, ("2/R1",))
    assert (found.address, found.x_mm, found.y_mm) == (("2/R1",), (25.4,), (-12.7,))
    assert (found.width_mm, found.height_mm, found.rotation_deg) == ((2.54,), (1.27,), (90.0,))
    assert found.outline_mm == ((0.0, 0.0), (50.8, -25.4))


def test_without_a_cad_mapping_only_the_order_states_the_flip() -> None:
    assert joined(side("bottom", cad_matrix=None), side("top")).flip is None
    assert joined(side("bottom", cad_matrix=None, flip="y"), side("top")).flip == "y"
