from __future__ import annotations

from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import Box, Design, Mark, Part, PlacedBoard, Placement
from vaoi_station.board_data.panels import Grid, laid_out, repeated

SQUARE = ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0))


def test_designators_that_stand_twice_on_one_board_are_left_out_of_all() -> None:
    body = Box((-1.0, -1.0), (1.0, 1.0))
    parts = tuple(Part(ref, "top", (float(n), 9.0), 0.0, box=body) for n, ref in enumerate(("R1", "J1", "C9", "R1")))
    panel = laid_out(repeated(Design("d", "kicad", parts), Grid((2, 1), (50.0, 0.0))))
    made, notes = to_board_type(panel, "top")
    assert [c.address for c in made.components] == ["1/J1", "1/C9", "2/J1", "2/C9"]
    assert any("occur more than once were left out: 1/R1, 2/R1" in note for note in notes)


def test_marks_on_both_sides_and_those_of_boards_upside_down() -> None:
    marks = (Mark("A", None, (2.0, 3.0)), Mark("B", "bottom", (5.0, 3.0)))
    one = Design("d", "odb", (Part("R1", "top", (9.0, 9.0), 30.0),), SQUARE, marks=marks)
    over = PlacedBoard("7", "7", one, Placement(True, 90.0, (100.0, 0.0)))
    panel = laid_out(Design("p", "odb", (), boards=(over,)))
    assert [(p.address, p.side, p.rotation) for p in panel.parts] == [("7/R1", "bottom", 60.0)]
    at = {(m.name, m.side): (round(m.at[0], 6), round(m.at[1], 6)) for m in panel.marks}
    # (x, y) is mirrored to (−x, y), and turned by 90° to (−y, −x).
    assert at == {("7/A", "top"): (97, -2), ("7/A", "bottom"): (97, -2), ("7/B", "top"): (97, -5)}


def test_marks_of_the_panel_that_its_names_call_panel_marks_place_it() -> None:
    inside, off = (
        Mark("PFID1", "top", (50.0, 50.0), kind="panel"),
        Mark("X", "top", (-5.0, 0.0), kind="panel", found_by="place"),
    )
    bad = Mark("BBM", "top", (10.0, 10.0), kind="bad-board")
    boards = tuple(
        PlacedBoard(str(n), str(n), Design("d", "odb", (), SQUARE), Placement(False, 0.0, (30.0 * n, 0.0)))
        for n in (0, 1)
    )
    marks = (inside, off, bad, Mark("BBM2", "top", (25.0, 10.0), kind="bad-board"))
    found = {m.name: (m.kind, m.panel) for m in laid_out(Design("p", "odb", (), boards=boards, marks=marks)).marks}
    assert found == {
        "PFID1": ("global", None),
        "X": ("panel", None),
        "BBM": ("bad-board", "0"),
        "BBM2": ("bad-board", None),
    }
