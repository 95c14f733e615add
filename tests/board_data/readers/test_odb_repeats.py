"""Step-and-repeat of ODB++ and IPC-2581: one small panel in both formats, and wrong files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import Options, read_design, to_board_type
from vaoi_station.board_data.design import Design
from vaoi_station.board_data.readers.odb import read_odb
from vaoi_station.errors import InputError

HEADER = "job/steps/panel/stephdr"
PLACES = {"1/R1": (15, 15), "2/R1": (70, 15), "3/R1": (40, 60), "4/C1": (94, 74), "3/J1": (30, 80)}
"""Origins on the panel, mm. The datum of the board, (2, 1), lies at (7, 6), (62, 6), (49, 52), (107, 50)."""


def odb(folder: Path, **members: str) -> Path:
    path = folder / "b.zip"
    path.write_bytes(samples.odb_zip(samples.ODB | samples.ODB_PANEL | members))
    return path


def panel(folder: Path, kind: str) -> Design:
    path = odb(folder)
    if kind == "ipc2581":
        path = folder / "b.xml"
        path.write_text(samples.IPC2581_PANEL)
    return read_design(path, Options(step="panel"))


@pytest.mark.parametrize("kind", ["odb", "ipc2581"])
def test_both_formats_put_the_boards_at_the_same_places(kind: str, tmp_path: Path) -> None:
    design = panel(tmp_path, kind)
    parts = {part.address: part for part in design.parts}
    assert len([address for address in parts if address.endswith("/R1")]) == 4
    for address, place in PLACES.items():
        assert parts[address].origin == pytest.approx(place, abs=1e-3), address
    assert [parts[f"{n}/R1"].rotation for n in (1, 2, 3, 4)] == [0, 0, 90, 0]
    assert [parts[f"{n}/J1"].rotation for n in (1, 3, 4)] == [90, 180, 270]
    assert [parts[f"{n}/J1"].side for n in (1, 4)] == ["top", "bottom"]
    # Seen from the top, the body of J1 still lies above its origin when its board is upside down.
    assert parts["4/J1"].origin == pytest.approx((79, 69), abs=1e-3)
    assert parts["4/J1"].center == pytest.approx((79, 73), abs=1e-3)
    assert design.notes[0].startswith("step panel is a panel of 4 boards: 4 of step ")
    assert design.notes[1] == "1 boards lie upside down, so that their other side is up: positions 4."


@pytest.mark.parametrize("kind", ["odb", "ipc2581"])
def test_fiducials_of_boards_and_of_the_panel_are_kept_apart(kind: str, tmp_path: Path) -> None:
    board, notes = to_board_type(panel(tmp_path, kind), "top")
    assert {c.address for c in board.components} >= {"1/R1", "2/J1", "3/R1", "4/C1"}
    assert "4/R1" not in {c.address for c in board.components}
    assert board.board_fiducials.keys() == {"1", "2", "3"}
    of_panel = {(f.x, f.y) for f in board.fiducials if f.panel is None}
    assert of_panel == {(3.0, 3.0), (117.0, 97.0)}
    of_boards = {f.panel: (f.x, f.y) for f in board.fiducials if f.panel is not None}
    assert of_boards == {"1": (10.0, 10.0), "2": (65.0, 10.0), "3": (45.0, 55.0)}
    assert any(note.startswith("one fiducial alone places 3 boards of the panel") for note in notes)
    bad = {m.panel: (m.x, m.y) for m in board.other_marks or ()}
    # The mark on board 2 is about this board, one on the rail about none.
    assert bad["2"] == (80.0, 20.0)
    assert bad.keys() == ({"2", None} if kind == "odb" else {"2"})
    assert board.outline is not None
    assert max(board.outline) == pytest.approx((120, 100), abs=1e-3)


@pytest.mark.parametrize("kind", ["odb", "ipc2581"])
def test_the_board_is_read_unless_the_panel_is_chosen(kind: str, tmp_path: Path) -> None:
    panel(tmp_path, kind)
    design = read_design(tmp_path / {"odb": "b.zip", "ipc2581": "b.xml"}[kind])
    assert design.step in ("pcb", "sample")
    assert set(design.steps) == {design.step, "panel"}
    assert not design.boards
    assert design.notes[-1].startswith("steps that repeat boards: panel. If panels run through the line, choose")


def test_panels_of_arrays_have_the_marks_of_each_array(tmp_path: Path) -> None:
    """Two arrays of two boards, the second turned by 180°; each has a fiducial on its rail."""
    repeat = "UNITS=MM\nSTEP-REPEAT {{\nNAME={}\nX={}\nY={}\nDX={}\nNX={}\nANGLE={}\n}}\n"
    marks = "UNITS=MM\n$0 r1000\n@0 .pad_usage\nP 1 1 0 P 0 0;0=2\n"
    path = odb(
        tmp_path,
        **{
            HEADER: repeat.format("array", 0, 0, 0, 1, 0) + repeat.format("ARRAY", 200, 50, 0, 1, 180),
            "job/steps/array/stephdr": repeat.format("pcb", 5, 5, 40, 2, 0),
            "job/steps/array/layers/top/features": marks,
            "job/steps/coupon/profile": "",
        },
    )
    board, notes = to_board_type(read_design(path, Options(step="PANEL")), "top")
    at = {c.address: c.center for c in board.components if c.ref == "R1"}
    # The datum of the board, (2, 1), lies at (5, 5) of the array.
    assert at == {"1/R1": (13.0, 14.0), "2/R1": (53.0, 14.0), "3/R1": (187.0, 36.0), "4/R1": (147.0, 36.0)}
    assert {(f.name, f.x, f.y) for f in board.fiducials if f.panel is None} >= {
        ("array-1/global1", 1.0, 1.0),
        ("array-2/global1", 199.0, 49.0),
    }
    assert any("4 boards: 4 of step pcb" in note for note in notes)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("ANGLE=270", "ANGLE=nan", "STEP-REPEAT in line 15: ANGLE is 'nan', but must be a number"),
        ("NX=2", "NX=-2", "NX is '-2', but must be a whole number from 1"),
        ("NX=2", "NX=100000", "the number of places of step 'pcb' is '100000 × 1', but must be at most 1000"),
        ("NX=2", "NX=0", "the number of places of step 'pcb' is '0 × 1', but must be at least 1 × 1"),
        ("DX=2.16535433", "DX=0", "the pitch of step 'pcb' along x is 0.0, but must be above 0 for 2 places"),
        ("NAME=PCB", "NAME=", "STEP-REPEAT in line 4: has no NAME of a step"),
        ("NAME=PCB", "NAME=other", "a panel repeats step 'other', which the design does not have"),
        ("NAME=PCB", "NAME=PANEL", "steps contain one another: panel > panel"),
        ("}\nTOP_ACTIVE=0\n", "", "STEP-REPEAT in line 25 has no end"),
    ],
)
def test_wrong_repeats_are_refused(before: str, after: str, message: str, tmp_path: Path) -> None:
    assert before in samples.ODB_PANEL[HEADER]
    path = odb(tmp_path, **{HEADER: samples.ODB_PANEL[HEADER].replace(before, after)})
    with pytest.raises(InputError, match=message):
        read_odb(path, "panel")
    assert read_odb(path).name == "pcb", "the board can still be read"


BOARD_HEADER = "job/steps/pcb/stephdr"
BLOCK = "UNITS=MM\nSTEP-REPEAT {\nNAME=coupon\nANGLE=\n}\n"


@pytest.mark.parametrize(
    ("header", "panel_step", "message"),
    [
        ("UNITS=MM\nX_DATUM=\n", "panel", "pcb/stephdr: X_DATUM is '', but must be a number"),
        ("UNITS=MILS\n", "panel", "pcb/stephdr: UNITS is 'MILS', but must be MM or INCH"),
        (BLOCK, "pcb", "pcb/stephdr, STEP-REPEAT in line 2: ANGLE is '', but must be a number"),
    ],
)
def test_a_wrong_header_of_odb_is_refused_only_for_a_panel(
    header: str, panel_step: str, message: str, tmp_path: Path
) -> None:
    right, path = read_odb(odb(tmp_path)), odb(tmp_path, **{BOARD_HEADER: header})
    assert read_odb(path) == right, "the board alone needs neither its datum nor what it repeats"
    if panel_step != "pcb":
        assert read_odb(path, "pcb").parts == right.parts
    with pytest.raises(InputError, match=message):
        read_odb(path, panel_step)


def test_a_panel_of_too_many_boards_or_parts_is_refused(tmp_path: Path) -> None:
    block = "STEP-REPEAT {{\nNAME={}\nDX=60\nDY=50\nNX={}\nNY={}\n}}\n"
    nested = {
        HEADER: "UNITS=MM\n" + block.format("array", 100, 1),
        "job/steps/array/stephdr": "UNITS=MM\n" + block.format("pcb", 100, 1),
    }
    with pytest.raises(InputError, match="number of boards of the panel is '1001 or more', but must be at most 1000"):
        read_odb(odb(tmp_path, **nested), "panel")
    parts = "UNITS=MM\n" + "".join(f"CMP 0 {n} 10 0 N R{n} 10k;\n" for n in range(45))
    many = {HEADER: "UNITS=MM\n" + block.format("pcb", 1000, 1), "job/steps/pcb/layers/comp_+_top/components": parts}
    with pytest.raises(InputError, match="the number of parts of the panel is 46000, but must be at most 40000"):
        read_design(odb(tmp_path, **many), Options(step="panel"))
    deep = {f"job/steps/s{n}/stephdr": block.format(f"s{n + 1}", 1, 1) for n in range(9)}
    with pytest.raises(InputError, match=r"the depth of its steps is .* but must be at most 8"):
        read_odb(odb(tmp_path, **deep), "s0")
