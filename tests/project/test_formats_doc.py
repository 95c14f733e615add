"""The examples of docs/formats.md can be read, and its tables name every key."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from vaoi_station.files import read_board_type, read_calibration, read_stitch
from vaoi_station.files.calibrations import Layout, read_layout
from vaoi_station.files.documents import check_format, parse, read_json
from vaoi_station.model import BoardType, Calibration, CameraHead, Component, Fiducial, RecordingHead, Stitch
from vaoi_station.photometry.flat_fields import CameraFields, FieldHead, FlatFieldDocument

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
SECTIONS = {part.split("\n", 1)[0]: part for part in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]}
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


@pytest.mark.parametrize(
    ("section", "model", "prefix"),
    [
        ("A recording", RecordingHead, ""),
        ("A recording", CameraHead, "cameras[]."),
        ("A calibration", Calibration, ""),
        ("A board type", BoardType, ""),
        ("A board type", Component, "components[]."),
        ("A result", Stitch, ""),
        ("Flat fields", FlatFieldDocument, ""),
        ("Flat fields", CameraFields, "cameras[]."),
        ("Flat fields", FieldHead, "fields[]."),
    ],
)
def test_tables_name_every_key_and_whether_it_is_required(section: str, model: type[BaseModel], prefix: str) -> None:
    documented: dict[str, str] = {}
    for row in re.findall(r"^\| (`.*?) \|(?:.*)\| (.*?) \|$", SECTIONS[section], re.MULTILINE):
        for key in re.findall(r"`([^`]+)`", row[0]):
            name = prefix + key[1:] if key.startswith(".") else key
            if name.startswith(prefix) and "." not in name.removeprefix(prefix):
                documented[name.removeprefix(prefix).removesuffix("[]")] = row[1]
    if not prefix:
        documented = {k: v for k, v in documented.items() if k in model.model_fields}
    assert set(documented) >= set(model.model_fields)
    required = {name for name, field in model.model_fields.items() if field.is_required()}
    assert {name for name in model.model_fields if documented[name] == "refused"} == required | _always_checked(model)


def _always_checked(model: type[BaseModel]) -> set[str]:
    """Results are built without naming format and version, but are never read without."""
    return {"format", "version"} & set(model.model_fields)


def test_fiducials_default_to_circles_as_the_table_says() -> None:
    values: dict[str, Any] = {"name": "F", "x": 0, "y": 0, "diameter": 1}
    assert Fiducial.model_validate(values).shape == "circle"
    assert '| `"circle"` |' in SECTIONS["A board type"]
