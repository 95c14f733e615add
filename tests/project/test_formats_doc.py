"""The examples of docs/formats.md can be read, and show every key."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import BaseModel

from vaoi_station.files import read_board_type, read_calibration, read_stitch
from vaoi_station.files.calibrations import Layout, read_layout
from vaoi_station.files.documents import check_format, parse, read_json
from vaoi_station.model import BoardType, Calibration, RecordingHead, Stitch
from vaoi_station.photometry.flat_fields import FlatFieldDocument

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```json\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def read_head(path: Path) -> RecordingHead:
    data = read_json(path)
    check_format(data, path, "vaoi-recording", 1)
    return parse(RecordingHead, data, path)


def read_flat_fields(path: Path) -> FlatFieldDocument:
    data = read_json(path)
    check_format(data, path, "vaoi-flatfield", 1)
    return parse(FlatFieldDocument, data, path)


READERS: list[tuple[Callable[[Path], BaseModel], type[BaseModel]]] = [
    (read_head, RecordingHead),
    (read_calibration, Calibration),
    (read_layout, Layout),
    (read_board_type, BoardType),
    (read_stitch, Stitch),
    (read_flat_fields, FlatFieldDocument),
]


def test_there_is_one_example_of_each_document() -> None:
    assert len(EXAMPLES) == len(READERS)


@pytest.mark.parametrize("k", range(len(READERS)), ids=[m.__name__ for _, m in READERS])
def test_examples_are_read_and_show_every_key(tmp_path: Path, k: int) -> None:
    read, model = READERS[k]
    path = tmp_path / "example.json"
    path.write_text(EXAMPLES[k], encoding="utf-8")
    assert isinstance(read(path), model)
    shown = set(json.loads(EXAMPLES[k]))
    assert set(model.model_fields) - shown <= {"covariances", "covariance"}
