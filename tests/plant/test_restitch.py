"""Archived runs stitched again."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from tests.plant.conftest import add_runs, filmed_again, outcome_of, task_of
from vaoi_station import RecordedRun, StitchedRun
from vaoi_station.child_environment import child_environment
from vaoi_station.errors import InputError
from vaoi_station.files.results import stitch_document
from vaoi_station.line_config import ExpectedBoard
from vaoi_station.model.board_type import Visibility
from vaoi_station.plant.archive import Archive, RunLabel, RunSelection
from vaoi_station.plant.cluster import ClusterOptions, WorkerFault, software
from vaoi_station.plant.restitch import (
    Session,
    Terms,
    open_archived,
    restitch,
    restitch_run,
)
from vaoi_station.stitching.expectation import StitchTerms

TERMS = StitchTerms(
    leading_edge_mm=3.0,
    conveyor_mm_s=(0.0, 100.0),
    expected_board=ExpectedBoard(rail_mm=1.0),
    visibility=Visibility(coverage=0.5),
    channels={},
)


def extracted(board: RecordedRun, folder: Path, made: dict[str, Any] | None, *, reference: bool = False) -> Path:
    """Copy the board's recording with the record of a station, and itself as its reference."""
    run = Path(shutil.copytree(board.directory, folder / "run"))
    record = {"id": "r", "started": "2026-03-01T08:00:00Z", "made_with": made}
    (run / "run.json").write_text(json.dumps(record), encoding="utf-8")
    if reference:
        shutil.copytree(board.directory, run / "reference")
    return run


@pytest.mark.parametrize("method", ["auto", "reference"])
def test_a_reference_that_is_absent_is_named(board: RecordedRun, method: str, tmp_path: Path) -> None:
    made = {"method": method, "reference": "taught", "terms": TERMS.model_dump(mode="json")}
    run = extracted(board, tmp_path, made)
    if method == "reference":
        with pytest.raises(InputError, match="needs a reference"):
            open_archived(run, tmp_path, Terms("any"))
    else:
        opened, notes = open_archived(run, tmp_path, Terms("any"))
        assert opened.reference is None
        assert notes == [
            "The reference taught, against which its station placed the board, is not in the archive."
        ]  # fmt: skip


def test_another_calibration_holds_for_the_reference_too(
    board: RecordedRun, moved_calibration: Path, tmp_path: Path
) -> None:
    made = {"method": "auto", "reference": "taught", "terms": TERMS.model_dump(mode="json")}
    run = extracted(board, tmp_path, made, reference=True)
    opened, notes = open_archived(run, tmp_path, Terms("any", calibration=moved_calibration.read_bytes()))
    assert (opened.reference is not None, notes) == (True, [])


def test_the_result_is_that_of_the_station(stored: Archive, stitched: StitchedRun, tmp_path: Path) -> None:
    document = outcome_of(stored, "r1", tmp_path)
    ours, theirs = json.loads(json.dumps(document["result"])), json.loads(json.dumps(stitch_document(stitched.result)))
    for result in (ours, theirs):
        del result["quality"]["timings_ms"]
        del result["quality"]["recording"]["name"]  # that of the folder
    assert ours == theirs, "to the last digit"
    assert (document["station"], document["run"]) == ("line 1", "r1")
    tables = document["tables"]
    assert isinstance(tables, dict)
    assert tables["runs"]["result"] == ["former", "new"]
    views = tables["views"]["x_px"]
    assert views[: len(views) // 2] == views[len(views) // 2 :]


def test_an_archive_that_is_not_seen_is_no_fault_of_the_run(board: RecordedRun, tmp_path: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 1)
    task = task_of(archive, "r0")
    assert isinstance(restitch_run(task), bytes)
    (tmp_path / "archive").rename(tmp_path / "elsewhere")
    unseen = restitch_run(task)
    assert isinstance(unseen, WorkerFault)
    assert "is no archive" in unseen.message
    (tmp_path / "elsewhere").rename(tmp_path / "archive")
    assert isinstance(restitch_run(task), bytes)


FLIPPED = gzip.compress(bytes(range(256)) * 9, mtime=0)
FLIPPED = FLIPPED[:10] + bytes([FLIPPED[10] ^ 0b110]) + FLIPPED[11:]
"""The bits say that the block is of a type that there is not."""


def test_a_call_writes_data_set_and_report_and_goes_on(
    session: Callable[..., Session], cluster: ClusterOptions, moved_calibration: Path, tmp_path: Path
) -> None:
    steps: list[tuple[int, int]] = []
    terms = Terms(software(), calibration=moved_calibration.read_bytes())

    def interrupt(done: int, runs: int) -> None:
        steps.append((done, runs))
        if done == 2:
            raise KeyboardInterrupt

    first = session(terms=terms)
    first.progress = interrupt
    with pytest.raises(KeyboardInterrupt):
        restitch(first, cluster)
    summary = restitch(session(terms=terms), cluster)
    assert steps == [(0, 4), (1, 4), (2, 4)]
    assert (summary.runs, summary.done, summary.stitched, summary.left_out) == (4, 4, 2, ())
    out = tmp_path / "out"
    runs = pq.read_table(out / "tables" / "runs").to_pylist()
    assert [(r["run"], r["result"]) for r in runs] == [
        (f"r{n}", result) for n in (0, 2, 1, 3) for result in ("former", "new")
    ], "by station, day and id, whatever was ready first"
    camera = summary.changes.cameras[0]
    assert camera.camera == 1
    assert camera.size_px == pytest.approx(0.2, abs=0.02)
    assert "Cameras" in (out / "report.html").read_text(encoding="utf-8")
    # Everything is done: no cluster is needed.
    nowhere = ClusterOptions(scheduler="tcp://127.0.0.1:1", patience_s=1)
    again = restitch(session(terms=terms), nowhere)
    assert (again.done, again.stitched) == (4, 0)
    with pytest.raises(InputError, match=r"restitch\.json: .* the calibration"):
        restitch(session(), cluster)


def test_faults_of_archives_are_named_and_the_rest_goes_on(
    session: Callable[..., Session], stored: Archive, cluster: ClusterOptions, tmp_path: Path
) -> None:
    copied = Archive.open(shutil.copytree(stored.url, tmp_path / "copied"))
    place = tmp_path / "copied"
    newer = place / copied.run("r1").key
    newer.write_text(newer.read_text().replace('"version": 1', '"version": 9'))
    half = place / copied.run("r2").key
    half.write_bytes(half.read_bytes()[:200])
    # The same run in both archives is one run; another run under its id is none.
    other = Archive.create(tmp_path / "other")
    folder = copied.extract("r0", tmp_path / "r0")
    shutil.copyfile(folder / "calibration.json", tmp_path / "c.json")
    calibration = json.loads((tmp_path / "c.json").read_text())
    (tmp_path / "c.json").write_text(json.dumps(calibration | {"created": "another day"}))
    other.add(
        folder,
        calibration=tmp_path / "c.json",
        station="line 0",
        label=RunLabel(run="r0", time="2026-11-01T10:00:00Z", serial="B0"),
    )
    summary = restitch(session(copied, other, stored, selection=RunSelection(until="2026-11-03")), cluster)
    text = "\n".join(summary.left_out)
    assert "version is 9" in text
    assert str(half) in text
    assert "r0.json: two runs have this id, and differ" in text
    assert (summary.runs, summary.done) == (2, 2), "r1 and r2 are whole in the third archive"
    assert json.loads((tmp_path / "out" / "left-out.json").read_text()) == list(summary.left_out)


def test_a_directory_of_something_else_is_refused(
    session: Callable[..., Session], cluster: ClusterOptions, tmp_path: Path
) -> None:
    made = session()
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "letter.txt").write_text("")
    with pytest.raises(InputError, match=r"is not empty and has no restitch\.json"):
        restitch(replace(made, out=tmp_path / "x"), cluster)


def test_a_damaged_file_of_a_run_is_left_out_with_what_to_do(
    session: Callable[..., Session], cluster: ClusterOptions, tmp_path: Path
) -> None:
    chosen = RunSelection(until="2026-11-01")
    restitch(session(selection=chosen), cluster)
    (path,) = (tmp_path / "out").rglob("r0-*.json.gz")
    path.write_bytes(b"nothing")
    summary = restitch(session(selection=chosen), cluster)
    assert "Delete it and repeat the command" in summary.left_out[0]


def test_another_run_under_the_same_id_is_not_taken_for_done(
    session: Callable[..., Session], stored: Archive, cluster: ClusterOptions, board: RecordedRun, tmp_path: Path
) -> None:
    chosen = RunSelection(until="2026-11-01")
    assert restitch(session(selection=chosen), cluster).stitched == 1
    other = Archive.create(tmp_path / "other")
    label = RunLabel(run="r0", time="2026-11-01T10:00:00Z", serial="another board")
    with filmed_again(board.directory, "r0") as folder:
        other.add(folder, station="line 0", label=label)
    assert other.run("r0").key == stored.run("r0").key
    again = restitch(session(other, selection=chosen), cluster)
    assert (again.done, again.stitched) == (1, 1)
    assert set(pq.read_table(tmp_path / "out" / "tables" / "runs")["board_id"].to_pylist()) == {"another board"}
    assert restitch(session(selection=chosen), cluster).stitched == 0


def test_ctrl_c_ends_the_command_and_leaves_a_state_that_goes_on(
    stored: Archive, cluster: ClusterOptions, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "vaoi_station", "restitch", stored.url, "--out", str(out)]
    screen, terminal = os.openpty()
    process = subprocess.Popen(
        [*command, "--workers", "1"],
        stdout=terminal, stderr=subprocess.PIPE, text=True, start_new_session=True, env=child_environment(),
    )  # fmt: skip
    os.close(terminal)
    shown = b""
    while (
        b"1/4" not in shown
    ):  # the bar of the first run; a command that ends closes the terminal, which raises OSError
        shown += os.read(screen, 1000)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the command and its workers
    _, said = process.communicate(timeout=60)
    os.close(screen)
    assert process.returncode == 130
    assert "Repeat the command to go on." in said
    assert "Traceback" not in said
    done = len(list(out.rglob("*.json.gz")))
    assert cluster.scheduler is not None
    again = subprocess.run(
        [*command, "--scheduler", cluster.scheduler, "--patience", "120"],
        capture_output=True, text=True, check=False, env=child_environment(),
    )  # fmt: skip
    assert (again.returncode, f"4 of 4 runs stitched, {4 - done} by this call" in again.stdout) == (0, True), again
