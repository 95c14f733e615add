"""Parse documents strictly and write files atomically."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pytest
from pydantic import BaseModel, Field

from tests.project.test_formats_doc import EXAMPLES, read_flat_fields, read_head
from vaoi_station.board_data.package_sizes import read_table
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.errors import DeviceError, InputError, InternalError, NotFoundError
from vaoi_station.files import read_board_type, read_calibration, read_stitch
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.calibrations import read_layout
from vaoi_station.files.caller_credentials import caller_credentials
from vaoi_station.files.documents import (
    check_format,
    parse,
    read_json,
    read_text,
    text_of,
    write_bytes,
    write_json,
)
from vaoi_station.files.results import read_heights
from vaoi_station.model import BoardType
from vaoi_station.settings.edits import Edit, edit_toml
from vaoi_station.simulation import read_scenario, scenario_path

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


def test_parse_reports_refused_items_and_not_a_short_array() -> None:
    class Box(BaseModel):
        sides: Annotated[tuple[int, ...], Field(min_length=1)]

    with pytest.raises(InputError, match=r"^box: sides\.0: Input should be a valid integer[^;]*\.$"):
        parse(Box, {"sides": ["x"]}, "box")
    with pytest.raises(InputError, match=r"^box: sides: Tuple should have at least 1 item"):
        parse(Box, {"sides": []}, "box")


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


BOARD = BoardType.model_validate(json.loads(EXAMPLES[3]))
SIZES = "[[package]]\npattern = '^MY-RELAY'\nsize = [15.0, 7.5]\n"
MARKS = {"UTF-8": "utf-8-sig", "UTF-16": "utf-16", "UTF-16 big-endian": "utf-16-be"}


class Kind(NamedTuple):
    """The content of a file, and how it is read."""

    text: Callable[[Path], str]
    read: Callable[[Path], object]


def _example(k: int) -> Callable[[Path], str]:
    return lambda _: EXAMPLES[k]


def _keys(folder: Path) -> str:
    KeyFile(folder / "made.json").create("line", ["read"])
    return (folder / "made.json").read_text()


def _station(folder: Path) -> str:
    return write_station_files(scenario_path("small"), folder / "station")[0].read_text()


KINDS = {
    "recording.json": Kind(_example(0), read_head),
    "calibration.json": Kind(_example(1), read_calibration),
    "layout.json": Kind(_example(2), read_layout),
    "board.json": Kind(_example(3), read_board_type),
    "result.json": Kind(_example(4), read_stitch),
    "flatfield.json": Kind(_example(5), read_flat_fields),
    "heights.json": Kind(
        lambda _: json.dumps({BOARD.components[0].ref: {"height_mm": 1.5, "sigma_mm": 0.1}}),
        lambda path: read_heights(path, BOARD),
    ),
    "station.toml": Kind(_station, read_config),
    "scenario.toml": Kind(lambda _: scenario_path("small").read_text(), read_scenario),
    "table of sizes": Kind(lambda _: SIZES, read_table),
    "keys.json": Kind(_keys, lambda path: KeyFile(path).entries()),
    "key of a caller": Kind(
        lambda _: "vaoi_0123456789ab_secret-part\r\n", lambda path: caller_credentials(path, environment={}).key
    ),
}


def _comparable(content: object) -> object:
    # The matrices of a document are arrays, which have no single answer to ==.
    return content.model_dump_json() if isinstance(content, BaseModel) else content


def marked(text: str, encoding: str) -> bytes:
    """Return a text as a program of Windows writes it."""
    return ("\ufeff" * encoding.endswith("-be") + text).encode(encoding)


@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_with_a_byte_order_mark_is_read_as_one_without(tmp_path: Path, kind: str, mark: str) -> None:
    text, path = KINDS[kind].text(tmp_path), tmp_path / "file.json"
    path.write_text(text, encoding="utf-8")
    plain = _comparable(KINDS[kind].read(path))
    path.write_bytes(marked(text, MARKS[mark]))
    assert _comparable(KINDS[kind].read(path)) == plain
    assert plain


@pytest.mark.parametrize("kind", KINDS)
def test_utf_16_without_a_mark_is_refused_with_the_file_the_encoding_and_an_action(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.json"
    path.write_bytes(KINDS[kind].text(tmp_path).encode("utf-16-le"))
    with pytest.raises(InputError, match=r"file\.json.*not UTF-8 text.*Save it as UTF-8") as refusal:
        KINDS[kind].read(path)
    assert refusal.value.action


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b'{"name": "M\xfcller"}', "is not UTF-8 text at byte 11"),
        (b"\xef\xbb\xbfa\xff", "is not UTF-8 text at byte 4"),
        (b"\xff\xfea", "is not UTF-16-LE text at byte 2"),
        (b"\xfe\xff\xd8\x00", "is not UTF-16-BE text at byte 2"),
        ("{}".encode("utf-32"), "has a zero character, so it is not UTF-16-LE text"),
        (b'{"a": "\x00"}', "has a zero character"),
    ],
)
def test_bytes_that_are_no_text_are_refused_with_the_place(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "file.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"file\.json: {reason}.*Save it as UTF-8"):
        read_json(path)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"absent: there is no such file"):
        read_text(tmp_path / "absent")
    with pytest.raises(InputError, match=r"cannot be read \(Is a directory\)"):
        read_text(tmp_path)


def test_invalid_bytes_are_replaced_on_request_and_only_the_first_mark_is_dropped() -> None:
    assert text_of(b"\xef\xbb\xbfa\xff", "x", "replace") == "a\ufffd"
    assert text_of(b"\xef\xbb\xbf\xef\xbb\xbfa", "x") == "\ufeffa"
    assert text_of(b"", "x") == ""


def test_an_edit_of_a_configuration_with_a_mark_keeps_the_rest(tmp_path: Path) -> None:
    text = "# Line 3\r\nname = 'é'  # its name\r\nrows = 1\r\n"
    (tmp_path / "station.toml").write_bytes(marked(text, "utf-8-sig"))
    edited = edit_toml(read_text(tmp_path / "station.toml"), [Edit(("rows",), 2)])
    assert edited == text.replace("rows = 1", "rows = 2")
