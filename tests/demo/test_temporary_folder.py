"""Temporary folders are removed by their program, or by the next one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vaoi_station.demo.temporary_folder import remove_abandoned, temporary_folder

OWNER = """
from vaoi_station.demo.temporary_folder import temporary_folder
with temporary_folder("test") as folder:
    (folder / "films").mkdir()
    print(folder, flush=True)
    input()
"""


@pytest.fixture(autouse=True)
def _temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


def start_owner() -> tuple[subprocess.Popen[str], Path]:
    """Start a program that owns a folder."""
    program = subprocess.Popen([sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    return program, Path(program.stdout.readline().strip())


def age(folder: Path) -> None:
    os.utime(folder, times=(time.time() - 3600,) * 2)


def test_only_the_folder_of_a_killed_program_is_removed_by_the_next(tmp_path: Path) -> None:
    lives, its = start_owner()
    killed, left = start_owner()
    other = tmp_path / "vaoi-other-1"
    link = tmp_path / "vaoi-test-link"
    other.mkdir()
    link.symlink_to(other)
    for folder in (its, left, other):
        age(folder)
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    with temporary_folder("test") as mine:
        assert sorted(tmp_path.iterdir()) == sorted([its, other, link, mine])
        assert (its / "films").is_dir()
    lives.communicate("\n")
    assert lives.returncode == 0
    assert sorted(tmp_path.iterdir()) == [other, link]


def test_new_folder_without_a_lock_is_not_removed(tmp_path: Path) -> None:
    fresh = tmp_path / "vaoi-test-fresh"
    fresh.mkdir()
    assert remove_abandoned("test") == []
    age(fresh)
    assert remove_abandoned("test") == [fresh]
    assert not fresh.exists()


def fail_inside() -> None:
    with temporary_folder("test") as folder:
        (folder / "file").write_text("…")
        raise KeyboardInterrupt


def test_folder_is_removed_after_an_exception(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        fail_inside()
    assert list(tmp_path.iterdir()) == []
