"""A small recording that tests of the plant share; and a board of the twin with its result, and an archive of it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import vaoi_station as vaoi
from vaoi_station import RecordedRun, StitchedRun, open_recording
from vaoi_station.files import read_calibration, write_calibration, write_recording
from vaoi_station.model import RecordingHead
from vaoi_station.plant.archive import Archive, RunLabel, RunSelection
from vaoi_station.plant.changes import Changes, compare
from vaoi_station.plant.cluster import ClusterOptions, cluster_address, software
from vaoi_station.plant.restitch import RunTask, Session, Terms, read_outcome, restitch_run
from vaoi_station.plant.tables import RunKey, Tables, result_tables, write_tables
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of two cameras and two rows of noise, of which one frame is missing; read only."""
    folder = tmp_path_factory.mktemp("recording")
    cameras = [{"width": 32, "height": 24, "exposure_us": 100.0}] * 2
    head = {"format": "vaoi-recording", "version": 1, "cameras": cameras, "rows": 2, "trigger_period_s": 0.1}
    head |= {"conveyor_mm_s": [0.0, 100.0], "missing": [[1, 1]], "x_shift": "night"}
    noise = np.random.default_rng(1).integers(90, 110, (3, 24, 32)).astype(np.uint8)
    frames = zip(((0, 0), (0, 1), (1, 0)), noise, strict=True)
    write_recording(folder, RecordingHead.model_validate(head), ((*at, image) for at, image in frames))
    matrix = [[40.0, 0.0, 16.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]]
    calibration = {"format": "vaoi-calibration", "version": 1, "unit": "mm", "camera_matrices": [matrix, matrix]}
    (folder / "calibration.json").write_text(json.dumps(calibration))
    marks = [{"name": name, "x": x, "y": 0.0, "diameter": 1.0} for name, x in (("F1", 0.0), ("F2", 10.0))]
    (folder / "board.json").write_text(json.dumps({"name": "demo", "fiducials": marks}))
    return folder


@pytest.fixture(scope="session")
def board(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    """Return a recording of a board under three cameras, with its `result.json`; read only."""
    folder = tmp_path_factory.mktemp("board")
    text = scenario_path("small").read_text(encoding="utf-8")
    # With two cameras a run does not show which of them is displaced.
    wide = text.replace("cameras = 2", "cameras = 3").replace("width_mm = 60.0", "width_mm = 88.0")
    (folder / "wide.toml").write_text(wide, encoding="utf-8")
    write_passage(Twin(read_scenario(folder / "wide.toml")).passage(0), folder / "run", with_truth=False)
    filmed = open_recording(folder / "run")
    filmed.stitch().save(folder / "run" / "result.json")
    return filmed


@pytest.fixture(scope="session")
def stitched(board: RecordedRun) -> StitchedRun:
    return board.with_result(board.directory / "result.json")


@pytest.fixture(scope="session")
def moved_calibration(board: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the calibration of the board with camera 1 displaced by 0.2 px along y, as a file."""
    path = tmp_path_factory.mktemp("moved") / "calibration.json"
    known = read_calibration(board.directory / "calibration.json")
    matrices = [np.array(matrix) for matrix in known.camera_matrices]
    matrices[1] = np.array([[1, 0, 0], [0, 1, 0.2], [0, 0, 1.0]]) @ matrices[1]
    write_calibration(path, known.model_copy(update={"camera_matrices": tuple(matrices)}))
    return path


@pytest.fixture(scope="session")
def stored(board: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """Return an archive of four runs of one board, on four days, at two stations; read only."""
    archive = Archive.create(tmp_path_factory.mktemp("stored") / "archive")
    add_runs(archive, board.directory, 4)
    return archive


@pytest.fixture(scope="session")
def cluster() -> Iterator[ClusterOptions]:
    """Return the options by which a call uses the two worker processes of the session, over TCP."""
    with cluster_address(ClusterOptions(workers=2)) as address:
        yield ClusterOptions(scheduler=address, patience_s=120)


def add_runs(archive: Archive, recording: Path, runs: int) -> None:
    """Add boards with equal frames: run r0 of board B0 on day 1 at line 0, r1 of B1 on day 2 at line 1, …"""
    for n in range(runs):
        label = RunLabel(run=f"r{n}", time=f"2026-11-{n % 28 + 1:02d}T10:00:00Z", serial=f"B{n}")
        with filmed_again(recording, f"r{n}") as folder:
            archive.add(folder, station=f"line {n % 2}", label=label)


@contextmanager
def filmed_again(recording: Path, run: str) -> Iterator[Path]:
    """Yield a recording with the same frames, as a station that replays them writes it: with the id of its run."""
    with TemporaryDirectory(dir=recording.parent) as scratch:
        folder = Path(shutil.copytree(recording, Path(scratch) / "run", copy_function=os.link))
        head = json.loads((folder / "recording.json").read_text(encoding="utf-8"))
        (folder / "recording.json").unlink()  # It is a link to that of the recording.
        (folder / "recording.json").write_text(json.dumps(head | {"x_run": run}), encoding="utf-8")
        yield folder


def task_of(archive: Archive, run: str, terms: Terms | None = None) -> RunTask:
    """Return the task of an archived run; by default to stitch it as its station did."""
    found = archive.run(run)
    return RunTask(archive.url, found.key, found.digest, terms or Terms(software()))


def outcome_of(archive: Archive, run: str, scratch: Path, terms: Terms | None = None) -> dict[str, Any]:
    """Stitch an archived run again in this process, and return the document of its outcome."""
    packed = restitch_run(task_of(archive, run, terms))
    assert isinstance(packed, bytes), packed
    (scratch / "run.json.gz").write_bytes(packed)
    return read_outcome(scratch / "run.json.gz")


@pytest.fixture(scope="session")
def changes(
    board: RecordedRun, stitched: StitchedRun, moved_calibration: Path, tmp_path_factory: pytest.TempPathFactory
) -> Changes:
    again = vaoi.open_recording(board.directory, calibration=moved_calibration).stitch()
    runs: list[Tables] = []
    for n in range(3):
        key = RunKey("line 1", f"r{n}", f"2026-11-{n + 1:02d}T10:00:00Z", "small", f"B{n}")
        results = (("former", stitched.result), ("new", again.result if n else stitched.result))
        # The last run has no former result.
        for name, result in results[n == 2 :]:
            runs.append(result_tables(key, name, result, board.board_type, stitched.recording.head))  # type: ignore[arg-type]
    tables = tmp_path_factory.mktemp("compared") / "tables"
    write_tables(tables, runs)
    return compare(tables)


@pytest.fixture(scope="session")
def boards(board: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """Return an archive of r0 … r3 of boards B0 … B3, in which R1 is not fitted, and of `bad`, which is degraded."""
    folder = tmp_path_factory.mktemp("boards")
    recording = Path(shutil.copytree(board.directory, folder / "run"))
    document = json.loads((recording / "board.json").read_text(encoding="utf-8"))
    for part in document["components"]:
        part["package"] = "0402" if part["ref"].startswith("R") else f"P {part['ref'][0]}"
        if part["ref"] == "R1":
            part["fitted"] = False
    (recording / "board.json").write_text(json.dumps(document), encoding="utf-8")
    archive = Archive.create(folder / "archive")
    add_runs(archive, recording, 4)
    result = json.loads((recording / "result.json").read_text(encoding="utf-8"))
    result |= {"status": "degraded", "reasons": ["dim"], "reason_codes": ["light-dark"]}
    (recording / "result.json").write_text(json.dumps(result), encoding="utf-8")
    archive.add(recording, station="line 9", label=RunLabel(run="bad", time="2026-11-09T10:00:00Z"))
    return archive


@pytest.fixture
def session(stored: Archive, tmp_path: Path) -> Callable[..., Session]:
    """Make what a call works on: by default the archive of four runs."""

    def make(*archives: Archive, terms: Terms | None = None, selection: RunSelection | None = None) -> Session:
        urls = [archive.url for archive in archives or (stored,)]
        return Session(urls, selection or RunSelection(), terms or Terms(software()), tmp_path / "out")

    return make
