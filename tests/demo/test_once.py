"""Where a demo may write."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.demo.once import PICTURES, REPORT, SHEET, clear
from vaoi_station.errors import InputError


def test_new_and_empty_directories_are_taken(tmp_path: Path) -> None:
    clear(tmp_path)
    clear(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_what_an_earlier_demo_wrote_makes_room_and_nothing_else_does(tmp_path: Path) -> None:
    (tmp_path / PICTURES / "U1").mkdir(parents=True)
    for name in (REPORT, SHEET, "mine.txt"):
        (tmp_path / name).write_text("x")
    clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_what_no_demo_wrote_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / PICTURES).mkdir()
    with pytest.raises(InputError, match="holds something no demo has written") as refusal:
        clear(tmp_path)
    assert "another --out" in refusal.value.action
    assert (tmp_path / PICTURES).is_dir()
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(InputError, match="is a file"):
        clear(file)
