from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import Grid, Options, read_design, to_board_type
from vaoi_station.board_data.design import Design
from vaoi_station.board_data.panels import repeated
from vaoi_station.errors import InputError

CSV = "ref,x,y,rotation,side,package\nR1,0mm,0mm,0,top,R0805\nJ1,20mm,10mm,90,top,X\nC9,5mm,15mm,0,top,C0402\n"


def grid(repeat: str, pitch: str, rotate: str | None = None, border: str | None = None) -> Options:
    return Options(grid=Grid.parse(repeat, pitch, rotate, border))


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A board of 50 × 45 mm, its corner at the origin."""
    (tmp_path / "b.kicad_pcb").write_text(samples.KICAD)
    return tmp_path / "b.kicad_pcb"


def test_a_board_is_repeated_about_the_middle_of_its_outline(board: Path) -> None:
    made, notes = to_board_type(read_design(board, grid("2x2", "60x50", "0,180", "5x7")), "top")
    at = {c.address: (c.center, c.rotation) for c in made.components if c.ref in ("R1", "J1")}
    # The middle of the board is at (25, 22.5). Every second board is turned about its own middle.
    assert at == {
        "1/R1": ((10.0, 10.0), 0.0),
        "1/J1": ((30.0, 24.0), 90.0),
        "2/R1": ((100.0, 35.0), 180.0),
        "2/J1": ((80.0, 21.0), 270.0),
        "3/R1": ((10.0, 60.0), 0.0),
        "3/J1": ((30.0, 74.0), 90.0),
        "4/R1": ((100.0, 85.0), 180.0),
        "4/J1": ((80.0, 71.0), 270.0),
    }
    assert {(f.name, f.panel): (f.x, f.y) for f in made.fiducials}["3/FID1", "3"] == (5.0, 55.0)
    low, high = made.extent()
    assert (*low, *high) == pytest.approx((-5, -7, 115, 102), abs=1e-3)
    assert len(made.cut_outs or ()) == 4
    assert any("the board is repeated 2 × 2 times" in note for note in notes)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (("2", "3x3", None, None), "--repeat: the value is '2', but must be two whole numbers such as 3x2"),
        (("2x1.5", "3x3", None, None), "--repeat: the value is '2x1.5', but must be whole numbers from 1"),
        (("0x2", "3x3", None, None), "--repeat: the value is '0x2'"),
        (("1000x1000", "3x3", None, None), "at most 1000 boards together"),
        (("2x2", None, None, None), "--repeat 2x2 needs --pitch, two lengths in mm such as 30x28.5, from board to"),
        (("2x2", "", None, None), "--repeat 2x2 needs --pitch"),
        (("2x2", "1e9x3", None, None), "--pitch: the value is '1e9x3'"),
        (("2x2", "3x99999", None, None), "--pitch: the value is '3x99999'"),
        (("2x2", "30x0.5", None, None), "--pitch: the length along y is 0.5, but must be 1 mm at least"),
        (("2x2", "30x30", "0,x", None), "--rotate: the value is '0,x', but must be angles in degrees"),
        (("2x2", "30x30", "nan", None), "--rotate: the value is 'nan'"),
        (("2x2", "30x30", None, "-1x5"), "--border: the value is '-1x5', but must be 0 mm at least"),
        ((None, "30x30", None, None), "--pitch: the value is '30x30', but must be given together with --repeat"),
        (("", None, "90", ""), "--rotate: the value is '90', but must be given together with --repeat"),
    ],
)
def test_a_grid_that_cannot_be_understood_is_refused(texts: tuple[str | None, ...], message: str) -> None:
    repeat, pitch, rotate, border = texts
    with pytest.raises(InputError, match=message):
        Grid.parse(repeat, pitch, rotate, border)


def test_only_a_single_board_is_repeated_or_joined(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(samples.odb_zip(samples.ODB | samples.ODB_PANEL))
    (tmp_path / "p.csv").write_text(CSV)
    with pytest.raises(InputError, match="'panel' is a panel of 4 boards; --repeat is for one board"):
        read_design(tmp_path / "b.zip", Options(step="panel", grid=Grid.parse("2x2", "9x9", None, None)))
    with pytest.raises(InputError, match="'panel' is a panel of 4 boards; only files of one board can be joined"):
        read_design(tmp_path / "p.csv", Options(step="panel"), tmp_path / "b.zip")
    with pytest.raises(InputError, match="'p' has no outline, so that --border does not state where the panel ends"):
        read_design(tmp_path / "p.csv", grid("2x2", "50x50", None, "1x1"))


def test_sizes_of_the_table_hold_for_all_boards_and_an_empty_design_stays(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(CSV)
    made, notes = to_board_type(read_design(tmp_path / "p.csv", grid("3x1", "50x50", "90")), "top")
    assert [c.width for c in made.components if c.ref == "R1"] == [2.0] * 3
    assert any("guess for 1/J1, 2/J1, 3/J1" in note for note in notes)
    # The edges of a board that has no outline are not known either, so that --border would be refused.
    assert [note.code for note in notes if "outline" in note] == ["outline-absent"]
    # Without an outline the board turns about the middle of its parts, (10, 7.5).
    assert next(c.center for c in made.components if c.address == "1/R1") == pytest.approx((17.5, -2.5))
    empty = Design("d", "kicad", ())
    assert repeated(empty, Grid((2, 2), (9.0, 9.0))) is empty
