"""`vaoi archive …`: what it prints, and its exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.plant.archive import Archive


@pytest.fixture
def filmed(small_recording: Path, tmp_path: Path, vaoi: Any) -> Path:
    """Return an archive that the commands have made, with one run."""
    archive = tmp_path / "archive"
    assert vaoi("archive", "create", archive).code == 0
    said = vaoi(
        "archive", "add", archive, small_recording, "--station", "one", "--run", "a", "--time", "2026-03-01T08:00:00Z"
    )
    assert (said.code, said.err) == (0, "")
    assert "→ run a," in said.out
    return archive


def test_runs_are_listed_verified_and_restored(filmed: Path, tmp_path: Path, vaoi: Any) -> None:
    assert "a  2026-03-01T08:00:00Z  one" in vaoi("archive", "list", filmed).out
    listed = json.loads(vaoi("archive", "list", filmed, "--json", "--station", "o*").out)
    assert (listed["run"], listed["frames"]) == ("a", 12)
    assert vaoi("archive", "list", filmed, "--until", "2026-02-28").out == ""
    assert "0 runs damaged, 0 faults" in vaoi("archive", "verify", filmed).out
    assert vaoi("archive", "restore", filmed, "--out", tmp_path / "back").out.strip() == str(tmp_path / "back" / "a")
    assert (tmp_path / "back" / "a" / "frames" / "c00_r000.tiff").is_file()


def test_faults_are_named_and_the_exit_code_says_so(filmed: Path, tmp_path: Path, vaoi: Any) -> None:
    archive = Archive.open(filmed)
    archive.storage.delete(archive.run("a").frames[0].key)
    said = vaoi("archive", "verify", filmed)
    assert said.code == 1
    assert "run a: blob" in said.err
    assert "1 runs damaged, 1 faults" in said.out
    assert vaoi("archive", "restore", filmed, "--out", tmp_path / "back").code == 1
    assert vaoi("archive", "add", filmed, tmp_path).code == 1


def test_a_damaged_frame_comes_back_from_the_recording(filmed: Path, small_recording: Path, vaoi: Any) -> None:
    frame = filmed / Archive.open(filmed).run("a").frames[0].key
    damaged = bytearray(frame.read_bytes())
    damaged[100] ^= 1
    frame.write_bytes(damaged)
    assert "or add the run again from its recording" in vaoi("archive", "verify", filmed).err
    given = ("--station", "one", "--run", "a", "--time", "2026-03-01T08:00:00Z")
    assert vaoi("archive", "add", filmed, small_recording, *given).code == 0
    assert "0 runs damaged, 0 faults" in vaoi("archive", "verify", filmed).out


def test_pruning_asks_for_a_confirmation(filmed: Path, vaoi: Any) -> None:
    said = vaoi("archive", "prune", filmed, "--run", "a")
    assert "1 runs, 0 blobs" in said.out
    assert "--confirm removes" in said.out
    assert vaoi("archive", "prune", filmed, "--run", "a", "--confirm").code == 0
    assert vaoi("archive", "list", filmed).out == ""


def test_pruning_refuses_what_would_remove_too_much(filmed: Path, vaoi: Any) -> None:
    said = vaoi("archive", "prune", filmed, "--run", "a", "--verdict", "failed", "--confirm")
    assert (said.code, "--verdict is 'failed'" in said.err) == (2, True)
    assert "a  2026-03-01" in vaoi("archive", "list", filmed).out
    said = vaoi("archive", "prune", filmed, "--grace-hours", "17")
    assert (said.code, "--nothing-added" in said.err) == (2, True)
    assert vaoi("archive", "prune", filmed, "--grace-hours", "17", "--nothing-added").code == 0


def test_what_is_no_archive_is_refused(tmp_path: Path, vaoi: Any) -> None:
    said = vaoi("archive", "list", tmp_path)
    assert said.code == 2
    assert "is no archive" in said.err
