"""Files of good boards: read again as written, small, mergeable, and refused when damaged."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.parts.conftest import stitched
from vaoi_station.errors import InputError
from vaoi_station.parts.learned import TaughtBoard, merged, read_taught_board, without


def test_a_board_is_read_as_it_was_written(good_boards: tuple[TaughtBoard, ...], tmp_path: Path) -> None:
    board, path = good_boards[0], tmp_path / "good.parts"
    board.write(path)
    again = read_taught_board(path)
    assert (again.name, again.grids, again.addresses, again.classes) == (
        board.name, board.grids, board.addresses, board.classes,
    )  # fmt: skip
    for a, b in zip(board.patches, again.patches, strict=True):
        np.testing.assert_array_equal(a, b)
    for c, d in zip(board.heights_mm, again.heights_mm, strict=True):
        np.testing.assert_array_equal(c, d)
    assert path.stat().st_size <= 3000 * sum(map(len, board.addresses))


def test_boards_of_two_stations_are_merged_and_one_is_taken_out(good_boards: tuple[TaughtBoard, ...]) -> None:
    first, second = good_boards
    both = merged([second, first, second])
    assert [b.name for b in both] == ["good-0", "good-1"]
    assert without(both, "good-0") == (second,)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"{}"])
def test_a_damaged_file_is_refused_with_its_name(damage: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.parts"
    path.write_bytes(damage)
    with pytest.raises(InputError, match=r"bad\.parts.*teach the board again"):
        read_taught_board(path)


def test_a_cut_file_is_refused(good_boards: tuple[TaughtBoard, ...], tmp_path: Path) -> None:
    path = tmp_path / "cut.parts"
    good_boards[0].write(path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(InputError, match="damaged"):
        read_taught_board(path)


def test_a_member_that_cannot_be_unpacked_is_refused(good_boards: tuple[TaughtBoard, ...], tmp_path: Path) -> None:
    path = tmp_path / "bits.parts"
    good_boards[0].write(path)
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        begin = file.getinfo("0.patches").header_offset + 30 + len("0.patches")
    data[begin : begin + 20] = b"\xff" * 20
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"bits\.parts.*damaged"):
        read_taught_board(path)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("name", None, "'name'"),
        ("body_px", [], ""),
        ("body_px", "ab", ""),
        ("body_px", [1, 2, 3], ""),
        ("body_px", [-5, 3], r"grids\[0\].body_px is -5, must be 1 to"),
        ("px_per_mm", 0, r"grids\[0\].px_per_mm is 0, must be 0.1 to 10000"),
        ("px_per_mm", float("nan"), r"px_per_mm is nan"),
        ("px_per_mm", -40, r"px_per_mm is -40"),
        ("px_per_mm", 1e300, r"px_per_mm is 1e\+300"),
        ("width", 10**9, r"width is 1000000000, must be 1 to 2800"),
        ("height", 120, r"0.patches has \d+ bytes, must have"),
        ("parts", ["R1", "R1"], r"names 'R1' twice"),
        ("parts", ["R1"] * 30_000, r"the number of parts is 3\d{4}, must be 0 to 20000"),
    ],
)
def test_an_edited_head_is_refused(
    key: str, value: Any, said: str, good_boards: tuple[TaughtBoard, ...], tmp_path: Path
) -> None:
    path, edited = tmp_path / "good.parts", tmp_path / "edited.parts"
    good_boards[0].write(path)
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(edited, "w") as out:
        head = json.loads(file.read("head.json"))
        if value is None:
            del head["grids"][0][key]
        else:
            head["grids"][0][key] = value
        out.writestr("head.json", json.dumps(head))
        for member in file.namelist()[1:]:
            out.writestr(member, file.read(member))
    with pytest.raises(InputError, match=rf"edited\.parts.*damaged.*{said}"):
        read_taught_board(edited)


def test_a_board_of_another_type_is_told_from_one_of_a_changed_type(good_boards: tuple[TaughtBoard, ...]) -> None:
    board_type = stitched(0).board_type
    assert good_boards[0].is_of(board_type)
    parts = board_type.components
    moved = tuple(c.model_copy(update={"rotation": 90.0}) for c in parts)
    assert good_boards[0].is_of(board_type.model_copy(update={"components": moved[: len(parts) * 2 // 3]}))
    others = tuple(c.model_copy(update={"width": 2 * c.width}) for c in parts)
    assert not good_boards[0].is_of(board_type.model_copy(update={"components": others}))
