"""Panels whose boards have the same designators, as KiKit and KiCad itself write them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import Options, read_design, to_board_type
from vaoi_station.board_data.design import Design, Mark, NetPoint, Part
from vaoi_station.board_data.net_points import numbered
from vaoi_station.board_data.panels import Grid, laid_out, repeated, with_copies
from vaoi_station.errors import InputError

PLACES = {
    "U1": (5.0, 4.0, 0.0),
    "R1": (25.0, 2.0, 90.0),
    "R2": (2.0, 16.0, 270.0),
    "C1": (24.0, 17.0, 45.0),
    "J1": (14.0, 9.0, 0.0),
}
BOARD = Design(
    "d",
    "kicad",
    tuple(Part(ref, "bottom" if ref == "C1" else "top", (x, y), turn) for ref, (x, y, turn) in PLACES.items()),
    ((0.0, 0.0), (28.0, 0.0), (28.0, 20.0), (0.0, 20.0)),
    marks=(Mark("FID1", "top", (1.0, 1.0)), Mark("FID2", "top", (27.0, 19.0))),
)
RAIL = tuple(Mark("REF**", "top", at) for at in ((-3.0, -3.0), (120.0, -3.0), (-3.0, 90.0), (120.0, 90.0)))


def copied(grid: Grid, *more: Part) -> tuple[Design, Design]:
    """Return a panel, and the same as a file has it that does not state the positions."""
    panel = laid_out(repeated(BOARD, grid))
    parts = tuple(replace(part, panel=None) for part in (*panel.parts, *more))
    marks = tuple(replace(mark, panel=None, name=mark.name.rpartition("/")[2]) for mark in panel.marks)
    return panel, Design("d", "kicad", parts[::-1], marks=(*marks[::-1], *RAIL))


@pytest.mark.parametrize(
    "grid",
    [
        Grid((2, 2), (30.0, 22.0)),
        Grid((3, 2), (32.0, 25.0), (0.0, 180.0)),
        Grid((3, 1), (30.0, 0.0), (0.0, 180.0)),
        Grid((2, 2), (29.0, 29.0), (0.0, 90.0, 180.0, 270.0)),
    ],
)
def test_copies_of_a_board_are_recognised_and_numbered(grid: Grid) -> None:
    panel, file = copied(grid)
    found = laid_out(with_copies(file))
    expected = {part.address: part.origin for part in panel.parts}
    assert {part.address: part.origin for part in found.parts} == expected
    places = {mark.name: mark.at for mark in panel.marks}
    assert {mark.name: mark.at for mark in found.marks if mark.panel} == places
    assert {mark.at for mark in found.marks if mark.panel is None} == {mark.at for mark in RAIL}
    number = grid.counts[0] * grid.counts[1]
    assert f"the file was read as a panel of {number} boards" in found.notes[0]


@pytest.mark.parametrize("degrees", [(0.0, 180.0), (0.0, 90.0, 270.0, 180.0)])
def test_boards_that_are_turned_in_pairs_cannot_be_told_apart(degrees: tuple[float, ...]) -> None:
    """Turned by 180° about the middle between both, the parts of one board lie where those of the other were."""
    _, file = copied(Grid((2, len(degrees) // 2), (40.0, 40.0), degrees))
    assert with_copies(file) is file
    with pytest.raises(InputError, match="designators of the top occur more than once"):
        to_board_type(file, "top")


def test_a_kicad_file_of_a_panel_is_read_as_one(tmp_path: Path) -> None:
    start = samples.KICAD.index("(footprint")
    copy = samples.KICAD[start : samples.KICAD.index("(gr_line")]
    for before, after in (("(at 10 -10)", 70), ("(at 30 -20 90)", 90), ("(at 15 -25 270)", 75), ("(at 5 -5)", 65)):
        rest = before.removeprefix("(at ").partition(" ")[2]
        assert before in copy
        copy = copy.replace(before, f"(at {after} {rest}")
    path = tmp_path / "panel.kicad_pcb"
    path.write_text(samples.KICAD[:start] + copy + samples.KICAD[start:])
    board, notes = to_board_type(read_design(path), "top")
    assert {c.address: c.center for c in board.components if c.ref == "J1"} == {"1/J1": (30, 24), "2/J1": (90, 24)}
    assert {f.name: f.panel for f in board.fiducials} == {"1/FID1": "1", "2/FID1": "2"}
    assert any("read as a panel of 2 boards" in note for note in notes)
    with pytest.raises(InputError, match="is a panel of 2 boards; --repeat is for one board"):
        read_design(path, Options(grid=Grid((2, 1), (200.0, 0.0))))


def test_pads_and_vias_belong_to_the_board_that_they_lie_on() -> None:
    _, file = copied(Grid((2, 1), (30.0, 0.0)))
    points = [NetPoint(part.ref, "1", "N", part.origin, True, False) for part in file.parts]
    points += [NetPoint("", "", "N", (x, 9.5), True, True, "via") for x in (44.0, 14.0)]
    points += [NetPoint("", "", "N", (3.0, 3.0), True, False, "pad", None, "TP9")]
    found = laid_out(with_copies(replace(file, net_points=numbered(points)))).net_points
    at = {point.name: point.at for point in found}
    assert at["1/U1-1"] == (5.0, 4.0)
    assert at["2/U1-1"] == (35.0, 4.0)
    assert (at["1/VIA N"], at["2/VIA N"]) == ((14.0, 9.5), (44.0, 9.5))
    assert at["1/TP9"] == (3.0, 3.0)
    assert len(at) == len(points)


@pytest.mark.parametrize("turns", [(0.0,), (0.0, 90.0, 180.0, 270.0)])
def test_pads_far_from_the_origin_of_their_part_belong_to_its_board(turns: tuple[float, ...]) -> None:
    pads = (NetPoint("U1", str(k), "", (5.0 + 4 * k, 4.0), True, False, name=f"U1-{k}") for k in range(6))
    board = replace(BOARD, net_points=tuple(pads))
    panel = laid_out(repeated(board, Grid((2, 2), (29.0, 29.0), turns)))
    parts = tuple(replace(part, panel=None) for part in panel.parts)
    file = Design("d", "kicad", parts, net_points=tuple(p._replace(name="") for p in panel.net_points))
    found = laid_out(with_copies(file)).net_points
    assert {p.name: p.at for p in found} == {p.name: p.at for p in panel.net_points}
