"""Scenario files that name a board type: its section, and paths relative to the file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.simulation import read_scenario
from vaoi_station.simulation.board.layout import board_from_cad
from vaoi_station.simulation.scenario import BoardSection
from vaoi_station.simulation.scenario_files import section_of

BOARD = {
    "name": "given", "unit": "inch", "outline": [[1, 2], [3, 2], [3, 3], [1, 3]],
    "fiducials": [{"name": "F1", "x": 1.5, "y": 2.25, "diameter": 0.04}],
}  # fmt: skip


def test_the_section_follows_from_the_board_type(tmp_path: Path) -> None:
    (tmp_path / "board.json").write_text(json.dumps(BOARD), encoding="utf-8")
    (tmp_path / "scenario.toml").write_text('[board]\nfile = "board.json"\n', encoding="utf-8")
    section = read_scenario(tmp_path / "scenario.toml").board
    assert (section.name, section.unit, section.origin) == ("given", "inch", (1.0, 2.0))
    assert (section.width_mm, section.length_mm) == pytest.approx((50.8, 25.4))
    (mark,) = section.marks
    assert (mark.x_mm, mark.y_mm, mark.diameter_mm) == pytest.approx((12.7, 25.4 - 6.35, 1.016))
    assert board_from_cad(section) @ [1.5, 2.25, 1] == pytest.approx([12.7, 19.05, 1])
    bottom = section_of(BoardSection(), write(tmp_path, BOARD | {"side": "bottom"}))
    assert np.allclose(board_from_cad(bottom) @ [1.5, 2.25, 1], [50.8 - 12.7, 19.05, 1])


def test_a_board_that_the_twin_cannot_draw_is_refused(tmp_path: Path) -> None:
    outline = [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]
    with pytest.raises(InputError, match="width_mm"):
        section_of(BoardSection(), write(tmp_path, BOARD | {"outline": outline, "fiducials": []}))


def write(folder: Path, content: object) -> Path:
    path = folder / "other.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path
