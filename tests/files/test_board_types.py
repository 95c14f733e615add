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


def test_a_board_type_round_trips(tmp_path: Path, write: Write, board_document: dict[str, Any]) -> None:
    write_board_type(tmp_path / "again.json", read_board_type(write(board_document)))
    assert read_json(tmp_path / "again.json") == board_document


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("name"), "name: Field required"),
        (lambda d: d.update(unit="cm"), r"unit: .*'mm', 'inch' or 'mil' \(given: 'cm'\)"),
        (lambda d: d["components"][1].pop("panel"), "components contains 'U1' twice; names must be unique"),
        (lambda d: d["components"][1].update(ref="2/U1") or d["components"].append(dict(d["components"][0])), "twice"),
        (lambda d: d["fiducials"][1].update(x=3.01), r"fiducial 'F2' at \(3\.01, 1\.8\) lies outside the outline"),
        (lambda d: d["components"][0].update(rotation="90"), r"components\.0\.rotation: .*valid number"),
        (lambda d: d["components"][0].update(hieght=1), r"components\.0: unknown key\(s\) 'hieght'"),
    ],
)
def test_faulty_documents_are_refused_with_file_and_key(
    write: Write, board_document: dict[str, Any], change: Change, complaint: str
) -> None:
    change(board_document)
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}|document\.json: .*{complaint}"):
        read_board_type(write(board_document))
