"""The commands on archives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.plant.conftest import recording
from vaoi_station.plant.archive import Archive, RunLabel

__all__ = ["recording"]


@pytest.fixture
def archive(recording: Path, tmp_path: Path) -> Archive:
    """An archive of one run, of noise."""
    made = Archive.create(tmp_path / "archive")
    made.add(recording, station="line 1", label=RunLabel(run="r1", time="2026-11-01T10:00:00Z"))
    return made


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


NOWHERE = ("--scheduler", "tcp://127.0.0.1:1", "--patience", "1")


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        ((), 2, "one of them is needed"),
        (("--workers", "1", "--verdict", "good"), 2, "--verdict is 'good', but must be one of ok, degraded, failed"),
        (("--workers", "1", "--verdict", "ok,failed"), 2, "but must be one verdict"),
        (("--workers", "1", "--since", "May"), 2, "since is 'May'"),
        (("--workers", "1", "--calibration", "absent.json"), 2, "absent.json"),
        (NOWHERE, 3, "no scheduler answers within 1 s"),
    ],
)
def test_wrong_options_and_an_absent_scheduler_are_named(
    vaoi: Callable[..., Any], archive: Archive, tmp_path: Path, options: tuple[str, ...], code: int, text: str
) -> None:
    done = vaoi("restitch", archive.url, "--out", tmp_path / "out", *options)
    assert (done.code, text in done.err) == (code, True), done.err


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--verdict", "fine"), "--verdict is 'fine'"),
        (("--splits", "train=2"), "--splits is 'train=2'"),
        (("--limit", "0"), "limit is 0"),
    ],
)
def test_wrong_options_are_named(
    vaoi: Callable[..., Any], archive: Archive, tmp_path: Path, options: tuple[str, ...], text: str
) -> None:
    done = vaoi("dataset", archive.url, "--out", tmp_path / "out", *options)
    assert (done.code, text in done.err) == (2, True), done.err
    assert not (tmp_path / "out").exists()
