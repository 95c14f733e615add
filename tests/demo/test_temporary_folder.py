"""Folders for as long as a program runs."""

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


def owner() -> tuple[subprocess.Popen[str], Path]:
    """A program with a folder."""
    program = subprocess.Popen([sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    return program, Path(program.stdout.readline().strip())


def made_long_ago(folder: Path) -> None:
    os.utime(folder, times=(time.time() - 3600,) * 2)


def test_what_a_killed_program_has_left_is_put_away_by_the_next_and_nothing_else(tmp_path: Path) -> None:
    lives, its = owner()
    killed, left = owner()
    other = tmp_path / "vaoi-other-1"
    link = tmp_path / "vaoi-test-link"
    other.mkdir()
    link.symlink_to(other)
    for folder in (its, left, other):
        made_long_ago(folder)
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    with temporary_folder("test") as mine:
        assert sorted(tmp_path.iterdir()) == sorted([its, other, link, mine])
        assert (its / "films").is_dir()
    lives.communicate("\n")
    assert lives.returncode == 0
    assert sorted(tmp_path.iterdir()) == [other, link]


def test_a_folder_that_is_just_being_made_is_let_be(tmp_path: Path) -> None:
    fresh = tmp_path / "vaoi-test-fresh"
    fresh.mkdir()
    assert remove_abandoned("test") == []
    made_long_ago(fresh)
    assert remove_abandoned("test") == [fresh]
    assert not fresh.exists()


def fail_inside() -> None:
    with temporary_folder("test") as folder:
        (folder / "file").write_text("…")
        raise KeyboardInterrupt


def test_a_folder_is_gone_whatever_happens_in_it(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        fail_inside()
    assert list(tmp_path.iterdir()) == []
