"""Read and write board types."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import read_board_type, write_board_type
from vaoi_station.files.documents import read_json

Write = Callable[..., Path]
Change = Callable[[dict[str, Any]], object]
ELL = [[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]]


def test_a_board_type_round_trips(tmp_path: Path, write: Write, board_document: dict[str, Any]) -> None:
    write_board_type(tmp_path / "again.json", read_board_type(write(board_document)))
    assert read_json(tmp_path / "again.json") == board_document


def test_defaults_are_those_of_the_format(write: Write) -> None:
    component = {"ref": "R1", "center": [1, 1], "width": 1, "height": 1}
    fiducial = {"name": "F", "x": 1, "y": 2, "diameter": 1}
    board = read_board_type(write({"name": "bare", "components": [component], "fiducials": [fiducial]}))
    assert (board.unit, board.y_axis, board.side) == ("mm", "up", "top")
    assert board.outline is None
    assert (board.components[0].rotation, board.components[0].body_height) == (0, None)
    assert board.fixture_marks == ()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("name"), "name: Field required"),
        (lambda d: d.update(unit="cm"), r"unit: .*'mm', 'inch' or 'mil' \(given: 'cm'\)"),
        (lambda d: d.update(side="left"), r"side: .*'top' or 'bottom'"),
        (lambda d: d.update(y_axis="Up"), r"y_axis: .*'up' or 'down' \(given: 'Up'\)"),
        (lambda d: d["components"][1].pop("panel"), "components contains 'U1' twice; names must be unique"),
        (lambda d: d["components"][1].update(ref="2/U1") or d["components"].append(dict(d["components"][0])), "twice"),
        (lambda d: d["fiducials"][1].update(name="F1"), "fiducials contains 'F1' twice"),
        (lambda d: d["fiducials"][1].update(x=3.01), r"fiducial 'F2' at \(3\.01, 1\.8\) lies outside the outline"),
        (lambda d: d.update(outline=ELL), r"fiducial 'F2' at \(2\.8, 1\.8\) lies outside the outline"),
        (lambda d: d["fiducials"][0].update(shape="star"), r"fiducials\.0\.shape: "),
        (lambda d: d["fiducials"][0].update(diameter=0), r"fiducials\.0\.diameter: .*greater than 0"),
        (lambda d: d["components"][0].update(width=-1), r"components\.0\.width: .*greater than 0"),
        (lambda d: d["components"][0].update(center=[1]), r"components\.0\.center"),
        (lambda d: d["components"][0].update(body_height=-0.1), r"components\.0\.body_height: .*equal to 0"),
        (lambda d: d["components"][0].update(rotation="90"), r"components\.0\.rotation: .*valid number"),
        (lambda d: d["components"][0].update(hieght=1), r"components\.0: unknown key\(s\) 'hieght'"),
        (lambda d: d.update(outline=[[0, 0]]), "outline has one point"),
        (lambda d: d.update(outline=[[0, 0], [0, 5]]), "outline has no area"),
        (lambda d: d.pop("fixture_mark"), "fixture_mark is missing"),
    ],
)
def test_faulty_documents_are_refused_with_file_and_key(
    write: Write, board_document: dict[str, Any], change: Change, complaint: str
) -> None:
    change(board_document)
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}|document\.json: .*{complaint}"):
        read_board_type(write(board_document))
