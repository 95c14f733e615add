"""Board types from files, in Python; against a station: tests/cli/test_board_types.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import vaoi_station as vaoi
from tests.board_data.readers import samples


@pytest.fixture
def board(tmp_path: Path) -> Path:
    path = tmp_path / "b.kicad_pcb"
    path.write_text(samples.KICAD)
    return path


def test_a_board_type_is_made_of_one_file_or_two(board: Path, tmp_path: Path) -> None:
    bottom = vaoi.import_board_data(board, "bottom", name="p")
    assert (bottom.board_type.name, [c.ref for c in bottom.board_type.components]) == ("p", ["C1"])
    assert bottom.picture.startswith("<svg")
    places = tmp_path / "p.csv"
    places.write_text("Ref,X(mm),Y(mm),Rot\nR1,110,10,0\nJ1,130,20,90\nFID1,105,5,0\n")
    panel = vaoi.import_board_data(board, repeat="2x1", pitch="60x0")
    assert [c.address for c in panel.board_type.components][:4] == ["1/R1", "1/J1", "1/FID1", "2/R1"]
    assert any("shifted by (100.000, 0.000)" in line for line in vaoi.import_board_data(places, join=board).check)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"side": "left"}, "side is 'left'"),
        ({"units": "cm"}, "the unit is 'cm'"),
        ({"units": 1}, "units is 1, but must be a text"),
        ({"nonsense": "1"}, "nonsense is '1', but must be one of name"),
        ({"path": "/nowhere"}, "cannot be read"),
    ],
)
def test_wrong_arguments_are_input_errors(board: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(vaoi.InputError, match=message):
        vaoi.import_board_data(**{"path": board, **options})
