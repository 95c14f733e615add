"""`vaoi restitch`: exit codes, and what is named on stderr."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.plant.archive import Archive
from vaoi_station.plant.workers import ClusterOptions, cluster_address, crew
from vaoi_station.plant.workers.cluster import connection

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


def test_a_fault_of_an_archive_gives_exit_code_1(vaoi: Callable[..., Any], archive: Archive, tmp_path: Path) -> None:
    manifest = Path(archive.url) / archive.run("r1").key
    manifest.write_text("{")
    done = vaoi("restitch", archive.url, "--out", tmp_path / "out", *NOWHERE)
    assert done.code == 1, "without a run to do, no scheduler is needed"
    assert str(manifest) in done.err
    assert "0 of 0 runs stitched" in done.out
    assert len(json.loads((tmp_path / "out" / "left-out.json").read_text())) == 1


def pretend_to_be_old() -> None:
    """Run on a worker: have it state the software of a former release."""
    setattr(crew, "software", lambda: "vaoi_station 0.0.1")  # noqa: B010  (not a name that the module exports)


def test_a_worker_with_other_software_is_named_and_the_exit_code_says_so(
    vaoi: Callable[..., Any], archive: Archive, tmp_path: Path
) -> None:
    with cluster_address(ClusterOptions(workers=2)) as address, connection(address, 120) as client:
        client.wait_for_workers(2, timeout=120)
        link = client.dashboard_link
        other, _ = client.scheduler_info()["workers"]
        client.run(pretend_to_be_old, workers=[other])
        done = vaoi("restitch", archive.url, "--out", tmp_path / "out", "--scheduler", address, "--patience", "120")
    assert done.code == 1, done.err
    assert f"worker {other} is not used: it has vaoi_station 0.0.1, but must have" in done.err
    assert "1 of 1 runs stitched" in done.out
    assert f"dashboard: {link}" in done.out
    assert len(json.loads((tmp_path / "out" / "left-out.json").read_text())) == 1


def test_a_board_type_is_for_the_runs_of_its_name(
    vaoi: Callable[..., Any], archive: Archive, recording: Path, tmp_path: Path
) -> None:
    board = json.loads((recording / "board.json").read_text())
    (tmp_path / "board.json").write_text(json.dumps(board | {"name": "other"}))
    out = tmp_path / "out"
    done = vaoi("restitch", archive.url, "--out", out, "--board", tmp_path / "board.json", *NOWHERE)
    assert (done.code, "0 of 0 runs stitched" in done.out) == (0, True), done.err
    done = vaoi(
        "restitch", archive.url, "--out", out, "--board", tmp_path / "board.json", "--board-type", "demo", *NOWHERE
    )
    assert done.code == 3, "the run of the type demo is to be stitched"
