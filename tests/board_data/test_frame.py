from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.board_data import Options, read_design, to_board_type
from vaoi_station.board_data.design import XY, Design, extent
from vaoi_station.model import BoardType

FRAME = (-20.0, -20.0, 80.0, 60.0)
BOARD = (0.0, 0.0, 60.0, 40.0)
SLOT = (30.0, 30.0, 40.0, 35.0)


def imported(folder: Path, rectangles: list[tuple[float, ...]], parts: dict[str, XY]) -> tuple[Design, BoardType]:
    """Return what a KiCad file of rectangles and parts is imported as."""
    edges = [f"(gr_rect (start {a} {-b}) (end {c} {-d}) (layer Edge.Cuts))" for a, b, c, d in rectangles]
    placed = [
        f'(footprint "L:R" (layer F.Cu) (at {x} {-y}) (property Reference {ref}) (pad 1 smd rect (at 0 0) (size 1 1)))'
        for ref, (x, y) in parts.items()
    ]
    path = folder / "b.kicad_pcb"
    path.write_text(f"(kicad_pcb {' '.join(edges + placed)})", encoding="utf-8")
    design = read_design(path, Options())
    board, notes = to_board_type(design, "top")
    return design.with_notes(*notes[len(design.notes) :]), board


def corners(board: BoardType) -> tuple[XY, XY]:
    assert board.outline is not None
    return extent(board.outline)


@pytest.mark.parametrize("outer", [FRAME, (-0.1, -0.1, 60.1, 40.1)])
def test_the_contour_with_most_parts_is_the_board_and_keeps_its_cut_outs(
    outer: tuple[float, ...], tmp_path: Path
) -> None:
    design, board = imported(tmp_path, [outer, BOARD, SLOT], {"R1": (10, 10), "R2": (50, 10), "FID1": (5, 5)})
    assert corners(board) == ((0, 0), (60, 40))
    assert [extent(c) for c in board.cut_outs or ()] == [((30, 30), (40, 35))]
    codes = [note.code for note in design.notes]
    assert "frame-left-out" in codes
    assert not {"islands-left-out", "boards-in-outline", "parts-in-cut-outs"} & set(codes)


@pytest.mark.parametrize(
    ("rectangles", "parts"),
    [
        ([FRAME, (0, 0, 25, 40), (35, 0, 60, 40)], {"R1": (10, 10), "R2": (50, 10)}),
        ([FRAME, BOARD], {"R1": (10, 10), "R2": (50, 10), "FID1": (-10, -10), "FID2": (70, 50)}),
    ],
)
def test_contours_of_several_boards_or_amid_fiducials_are_no_cut_outs(
    rectangles: list[tuple[float, ...]], parts: dict[str, XY], tmp_path: Path
) -> None:
    if len(rectangles) == 2:
        parts = parts | {"R3": (20, 10)}
    design, board = imported(tmp_path, rectangles, parts)
    assert corners(board) == ((-20, -20), (80, 60))
    assert not board.cut_outs
    assert "boards-in-outline" in [note.code for note in design.notes]
