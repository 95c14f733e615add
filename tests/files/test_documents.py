"""Parse documents strictly and write files atomically."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, Field

from vaoi_station.errors import DeviceError, InputError, InternalError, NotFoundError
from vaoi_station.files.documents import check_format, parse, read_json, read_toml, write_bytes, write_json
from vaoi_station.model import Component, Fiducial

Write = Callable[..., Path]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"a": 1,}', r"document\.json: not valid JSON at line 1, column"),
        ('{"a": {"k": 1, "k": 2}}', r"document\.json: key 'k' appears twice"),
        ('{"a": [1, {"b": NaN}]}', r"document\.json: a\.1\.b is nan, but must be a finite number"),
        ('{"x_own": Infinity}', r"document\.json: x_own is inf, but must be a finite number"),
        ('{"a": 1e999}', r"document\.json: a is inf, but must be a finite number"),
        ("-Infinity", r"document\.json: the document is -inf"),
        ("[" * 100_000, r"document\.json: is nested too deeply"),
        ("", r"document\.json: not valid JSON at line 1"),
    ],
)
def test_invalid_json_is_refused_with_its_position(write: Write, text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        read_json(write(text))


def test_unreadable_files_are_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"absent\.json: there is no such file"):
        read_json(tmp_path / "absent.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_json(tmp_path)
    (tmp_path / "latin.json").write_bytes(b'{"name": "M\xfcller"}')
    with pytest.raises(InputError, match=r"latin\.json: is not UTF-8"):
        read_json(tmp_path / "latin.json")


def test_invalid_toml_is_refused_with_its_position(tmp_path: Path) -> None:
    (tmp_path / "station.toml").write_text("a = 1\nb = = 2\n")
    with pytest.raises(InputError, match=r"station\.toml: not valid TOML: .*line 2"):
        read_toml(tmp_path / "station.toml")


def test_document_round_trips(tmp_path: Path) -> None:
    document = {"a": [1, 2.5, None, "é"], "b": {"c": True}}
    write_json(tmp_path / "new" / "a.json", document)
    assert read_json(tmp_path / "new" / "a.json") == document


@pytest.mark.parametrize(
    ("document", "complaint"),
    [
        ([], "holds a list, must be an object"),
        ({}, "format is None, but must be 'vaoi-stitch'"),
        ({"format": "vaoi-recording", "version": 1}, "format is 'vaoi-recording', but must be 'vaoi-stitch'"),
        ({"format": "vaoi-stitch"}, "version is None, but must be 1"),
        ({"format": "vaoi-stitch", "version": 0}, r"version is 0, but must be 1\.$"),
        ({"format": "vaoi-stitch", "version": "1"}, "version is '1'"),
        ({"format": "vaoi-stitch", "version": True}, "version is True"),
        ({"format": "vaoi-stitch", "version": 2}, "version is 2, but must be 1. Use a newer vaoi_station"),
    ],
)
def test_foreign_formats_and_versions_are_refused_by_name(document: Any, complaint: str) -> None:
    with pytest.raises(InputError, match=f"^r.json: {complaint}"):
        check_format(document, Path("r.json"), "vaoi-stitch", 1)


def test_parse_names_file_key_value_and_limit() -> None:
    with pytest.raises(InputError) as refused:
        parse(Fiducial, {"name": "F1", "x": "3", "y": 2, "diameter": -1}, "board.json")
    text = str(refused.value)
    assert "board.json: x: Input should be a valid number (given: '3')" in text
    assert "board.json: diameter: Input should be greater than 0 (given: -1)" in text


def test_parse_reports_refused_items_and_not_a_short_array() -> None:
    class Box(BaseModel):
        sides: Annotated[tuple[int, ...], Field(min_length=1)]

    with pytest.raises(InputError, match=r"^box: sides\.0: Input should be a valid integer[^;]*\.$"):
        parse(Box, {"sides": ["x"]}, "box")
    with pytest.raises(InputError, match=r"^box: sides: Tuple should have at least 1 item"):
        parse(Box, {"sides": []}, "box")


def test_parse_reports_at_most_five_faults() -> None:
    faulty = {"ref": "", "center": ["a", "b"], "width": 0, "height": 0, "rotation": "x", "body_height": -1}
    with pytest.raises(InputError, match=r"; and 2 more\.$"):
        parse(Component, faulty, "board.json")


def test_numbers_that_json_cannot_hold_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    write_json(path, {"a": 1})
    with pytest.raises(InternalError, match=r"quality\.rms is nan"):
        write_json(path, {"quality": {"rms": float("nan")}})
    assert read_json(path) == {"a": 1}


def test_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "r.json"
    write_bytes(path, b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match=r"r\.json: cannot be written \(No space left on device\)"):
        write_bytes(path, b"new and longer")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["r.json"]


def test_file_appears_under_its_name_when_it_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "r.json", []
    real = os.fsync

    def look(handle: int) -> None:
        seen.append((path.exists(), os.fstat(handle).st_size))
        real(handle)

    monkeypatch.setattr(os, "fsync", look)
    write_bytes(path, b"0123456789")
    assert seen[0] == (False, 10)
    assert [there for there, _ in seen] == [False, True], "then the directory, so that the name survives a power cut"
    assert path.stat().st_mode & 0o777 == 0o644
