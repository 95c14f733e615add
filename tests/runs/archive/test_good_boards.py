"""Good boards of board types that are deleted and restored."""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.parts.learned import read_taught_board
from vaoi_station.runs.archive.measured_parts import MeasuredParts


def test_good_boards_come_back_beside_those_that_were_taught_meanwhile(tmp_path: Path) -> None:
    unused: Any = SimpleNamespace(store=SimpleNamespace(parts=None))
    parts = MeasuredParts(unused, unused, unused, unused, unused, tmp_path)
    kept = tmp_path / "X"
    for deletion in range(2):
        kept.mkdir(exist_ok=True)
        (kept / f"r{deletion}.parts").write_text("patches")
        parts.set_aside("X")
        assert not kept.exists()
        kept.mkdir()
        (kept / f"late{deletion}.parts").write_text("patches")
        parts.bring_back("X")
    assert sorted(file.name for file in kept.iterdir()) == ["late0.parts", "late1.parts", "r0.parts", "r1.parts"]


def test_a_head_of_any_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "huge.parts", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("head.json", b" " * (17 * 2**20))
    with pytest.raises(InputError, match=r"the size of head\.json"):
        read_taught_board(tmp_path / "huge.parts")
