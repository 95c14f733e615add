"""Mistakes that are refused: overwriting a device or a link, and board types of impossible size."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.errors import InputError
from vaoi_station.files.documents import write_json
from vaoi_station.model import BoardType


def board(**more: Any) -> dict[str, Any]:
    marks = [{"name": "A", "x": 1, "y": 1, "diameter": 1}, {"name": "B", "x": 30, "y": 20, "diameter": 1}]
    parts = [{"ref": "U1", "center": [10, 10], "width": 3, "height": 2}]
    return {"name": "b", "fiducials": marks, "components": parts} | more


def test_a_plausible_board_type_is_accepted() -> None:
    assert BoardType.model_validate(board()).component("U1") is not None


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"components": [{"ref": "U1", "center": [1, 1], "width": 1e-300, "height": 1}]}, "0.01 to 2000 mm"),
        ({"components": [{"ref": "U1", "center": [1, 1], "width": 1e9, "height": 1}]}, "0.01 to 2000 mm"),
        ({"fiducials": [{"name": n, "x": 5, "y": 5, "diameter": 1} for n in "AB"]}, "0.1 mm apart"),
        ({"fiducials": [{"name": "A", "x": 5, "y": 5, "diameter": 1e6}]}, "0.05 to 50 mm"),
        (
            {"components": [{"ref": f"R{n}", "center": [n, 0], "width": 1, "height": 1} for n in range(20_001)]},
            "the limit is 20000",
        ),
    ],
)
def test_impossible_dimensions_are_refused(more: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        BoardType.model_validate(board(**more))


def test_a_device_or_directory_is_not_overwritten(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for place in (pipe, tmp_path):
        with pytest.raises(InputError, match="is not a file and is not overwritten"):
            write_json(place, {})
    assert pipe.is_fifo()


def test_a_symbolic_link_is_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    target.write_text("{}")
    link.symlink_to(target)
    write_json(link, {"a": 1})
    assert link.is_symlink()
    assert '"a": 1' in target.read_text()
