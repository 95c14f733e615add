"""Read and write layouts of calibration boards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.documents import read_json
from vaoi_station.files.layouts import read_layout, write_layout

Write = Callable[..., Path]


@pytest.fixture
def document() -> dict[str, Any]:
    """Four crosses."""
    return {
        "unit": "inch",
        "mark": {"shape": "cross", "size": 0.08, "width": 0.02, "polarity": "light"},
        "marks": [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}, {"x": 0.0, "y": 1.0}, {"x": 1.0, "y": 1.0}],
        "x_serial": "KB-7",
    }


def test_a_layout_round_trips(tmp_path: Path, write: Write, document: dict[str, Any]) -> None:
    layout = read_layout(write(document))
    assert layout.mm_per_unit == pytest.approx(25.4)
    write_layout(tmp_path / "layout.json", layout)
    assert read_json(tmp_path / "layout.json") == document


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"unit": "cm"}, r"unit: .*\(given: 'cm'\)"),
        ({"mark": {"shape": "dot", "size": 1, "width": 1}}, r"mark\.shape: "),
        ({"mark": {"size": 1, "width": 0}}, r"mark\.width: .*greater than 0"),
        ({"marks": [{"x": 0, "y": 0}] * 3}, "marks: .*at least 4"),
        ({"origin": 0}, r"unknown key\(s\) 'origin'"),
    ],
)
def test_faulty_layouts_are_refused(
    write: Write, document: dict[str, Any], change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}"):
        read_layout(write(document | change))
