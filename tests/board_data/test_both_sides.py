"""Both sides of a real board, from KiCad and ODB++, lie in one system where the page of InteractiveHtmlBom has them.

orangecrab_sides.csv has side, place and angle of each footprint as the page states them: hardware/orangecrab_r0.2.1/
Production/OrangeCrab-ibom.html of orangecrab-fpga/orangecrab-hardware, commit b515209, with y turned up.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi
from tests.needs import FILMS, need_films
from vaoi_station.runs.board_sides import BoardSide, join_sides, parts_of

PAGE = Path(__file__).with_name("orangecrab_sides.csv")


@pytest.mark.parametrize(("file", "least"), [("orangecrab.kicad_pcb", 148), ("orangecrab.odb.zip", 160)])
def test_both_sides_lie_where_the_page_of_another_program_has_them(file: str, least: int) -> None:
    need_films()
    page = {row["ref"]: row for row in csv.DictReader(PAGE.read_text().splitlines())}
    found, sides = 0, []
    for side in ("top", "bottom"):
        board = vaoi.import_board_data(FILMS / "boards" / "orangecrab" / file, side=side).board_type
        parts, up = parts_of(board), (1.0, 1.0 if board.y_axis == "up" else -1.0)
        for part, turn_deg in zip(board.components, parts.rotation_deg, strict=True):
            if (row := page.get(part.ref)) is None:
                continue
            found += 1
            place = np.array(part.origin or part.center) * board.mm_per_unit * up
            assert row["side"] == side, part.ref
            assert np.hypot(*(place - [float(row["x_mm"]), float(row["y_mm"])])) < 0.01, part.ref
            assert abs((turn_deg - float(row["angle_deg"]) + 180) % 360 - 180) < 0.01, part.ref
        low, high = np.sort(np.array(board.extent()) * board.mm_per_unit * up, axis=0).tolist()
        sides.append(BoardSide(
            side=side, run=side, address="", board_type=file, started="2026-11-29T10:00:00Z", verdict="ok",
            components=len(board.components), extent_mm=(tuple(low), tuple(high)), parts=parts,
            cad_matrix=((1.0, 0.0, 9.0), (0.0, 1.0 if side == "top" else -1.0, 9.0), (0.0, 0.0, 1.0)),
            turn_certain=True,
        ))  # fmt: skip
    assert found >= least
    joined = join_sides("SN-1", sides, 1.0)
    assert (joined.reasons, joined.flip) == ((), "x")
