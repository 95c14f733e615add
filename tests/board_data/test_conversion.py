from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.board_data import conversion
from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import Box, Design, ImportedTable, Mark, Part
from vaoi_station.errors import InputError

BODY = Box((-1.0, -0.5), (1.0, 0.5))
OUTLINE = ((0.0, 0.0), (50.0, 0.0), (50.0, 40.0), (0.0, 40.0))


def part(ref: str, **change: object) -> Part:
    return replace(Part(ref, "top", (10.0, 10.0), 0.0, box=BODY), **change)  # type: ignore[arg-type]


def design(*parts: Part, **change: object) -> Design:
    return replace(Design("d", "kicad", parts, OUTLINE), **change)  # type: ignore[arg-type]


def test_the_body_is_the_centre_and_the_origin_is_kept_where_it_differs() -> None:
    board, _ = to_board_type(design(part("R1"), part("J1", box=Box((0, 0), (6, 2)), rotation=90.0)), "top")
    r1, j1 = board.components
    assert (r1.center, r1.origin, (r1.width, r1.height)) == ((10, 10), None, (2, 1))
    assert (j1.center, j1.origin, j1.rotation) == ((9, 13), (10, 10), 90)


def test_only_the_chosen_side_is_taken_and_an_empty_one_is_refused() -> None:
    both = design(part("R1"), part("R2", side="bottom"))
    assert [c.ref for c in to_board_type(both, "bottom")[0].components] == ["R2"]
    with pytest.raises(InputError, match="has no part on the bottom; parts: 1 on the top"):
        to_board_type(design(part("R1")), "bottom")


def test_lines_of_repeated_designators_and_the_side_of_a_table_are_said() -> None:
    twice = design(part("R1"), part("C1", line=3), part("C1", line=7, origin=(30.0, 20.0)))
    assert any("were left out: C1 (lines 3, 7)." in note for note in to_board_type(twice, "top")[1])
    table = ImportedTable(delimiter="comma", unit="mm", unit_from="as given", columns=[])
    for change, advice in (({"table": table}, "state it by --columns side=bottom"), ({}, "Choose the side by --side")):
        with pytest.raises(InputError) as refused:
            to_board_type(design(part("R1"), **change), "bottom")
        assert advice in refused.value.action


def test_copies_of_a_board_that_no_position_tells_apart_are_named_or_refused() -> None:
    copies = tuple(part(ref, origin=(x, 10.0)) for ref in ("R1", "C1") for x in (10.0, 30.0))
    with pytest.raises(InputError, match=r"2 of 2 designators of the top occur more than once.* by --repeat and --pit"):
        to_board_type(design(*copies), "top")
    board, notes = to_board_type(design(*copies, part("J1")), "top")
    assert [c.ref for c in board.components] == ["J1"]
    assert any(
        "2 of 3 designators of the top occur more than once: the file seems to be of a panel" in n for n in notes
    )


def test_fiducials_by_file_by_name_and_explicit_ones() -> None:
    by_file = design(part("H1", is_mark=True, mark_diameter=0.75), part("FID9"))
    assert [(f.name, f.diameter) for f in to_board_type(by_file, "top")[0].fiducials] == [("H1", 0.75)]
    by_name = design(part("FID1", package="Fiducial_1.5mm"), part("FD2", origin=(40.0, 30.0)), part("R1"))
    board, notes = to_board_type(by_name, "top")
    assert [(f.name, f.diameter) for f in board.fiducials] == [("FID1", 1.5), ("FD2", 1.0)]
    assert any("no diameter of FD2; 1 mm is assumed" in note for note in notes)
    marks = (Mark("G1", "top", (1.0, 1.0), 2.0), Mark("B1", "bottom", (2.0, 2.0)), Mark("A1", None, (3.0, 3.0)))
    explicit, _ = to_board_type(design(part("FID1"), marks=marks), "top")
    assert [f.name for f in explicit.fiducials] == ["G1", "A1"]


def test_parts_outside_fiducials_outside_and_unfitted_parts() -> None:
    parts = (part("R1", origin=(90.0, 10.0)), part("C1", fitted=False), part("C2", size_from="guess"))
    board, notes = to_board_type(design(*parts), "top")
    assert [c.fitted for c in board.components] == [None, False, None]
    assert [c.size_from for c in board.components] == ["file", "file", "guess"]
    assert any("1 parts lie outside the outline: R1" in note for note in notes)
    assert any("is a guess for C2" in note for note in notes)


def test_cut_outs_that_leave_the_outline_or_exceed_the_limit_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    hole = ((5.0, 5.0), (9.0, 5.0), (9.0, 9.0), (5.0, 9.0))
    notch = ((20.0, 39.0), (21.0, 41.0), (22.0, 39.0), (21.0, 38.0))
    board, notes = to_board_type(design(part("R1"), cut_outs=(notch, hole)), "top")
    assert board.cut_outs == (hole,)
    assert any(note.startswith("1 contours lie outside the outline") for note in notes)
    monkeypatch.setattr(conversion, "MOST_CUT_OUT_CORNERS", 6)
    smaller = tuple((x / 2, y / 2) for x, y in hole)
    assert to_board_type(design(part("R1"), cut_outs=(smaller, hole)), "top")[0].cut_outs == (hole,)


A, D, R = "parts-alternative", "parts-doubled", "designators-repeated"


@pytest.mark.parametrize(
    ("parts", "kept", "code"),
    [
        ([{}, {"fitted": False}], (10, True), A),
        ([{"fitted": False}, {"origin": (30.0, 20.0)}], (30, True), A),
        ([{"fitted": False}, {"fitted": False, "origin": (9.0, 5.0)}, {"origin": (30.0, 20.0)}], (30, True), A),
        ([{"in_bom": False}, {"origin": (30.0, 20.0)}], (30, True), A),
        ([{}, {"package": "other", "fitted": False}], (10, True), A),
        ([{}, {}], (10, True), D),
        ([{}, {"origin": (10.008, 10.0), "rotation": 359.95}, {}], (10, True), D),
        ([{"fitted": False}, {"fitted": False}], (10, False), D),
        ([{}, {"origin": (30.0, 20.0)}], None, R),
        ([{}, {"package": "other"}], None, R),
        ([{}, {"rotation": 90.0}], None, R),
        ([{"fitted": False}, {"fitted": False, "origin": (30.0, 20.0)}], None, R),
        ([{}, {"origin": (30.0, 20.0)}, {"fitted": False}], None, R),
    ],
)  # fmt: skip
def test_of_parts_with_one_designator_the_fitted_one_stays(
    parts: list[dict[str, Any]], kept: tuple[float, bool] | None, code: str
) -> None:
    """Drawn as alternatives, or twice; what is neither is left out."""
    others = [part(f"C{n}", origin=(20.0, 20.0 + n)) for n in range(3)]
    board, notes = to_board_type(design(*others, *(part("R1", **change) for change in parts)), "top")
    found = [(c.center[0], c.fitted is not False) for c in board.components if c.ref == "R1"]
    assert found == ([kept] if kept else [])
    (note,) = (note for note in notes if "R1" in note)
    assert note.code == code
