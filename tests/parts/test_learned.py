"""Files of good boards: read again as written, small, mergeable, and refused when damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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
