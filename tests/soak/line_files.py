"""The files of a soaked station: a few recordings of the smallest board, in a random order, and station.toml."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.config import (
    CameraConfig,
    ControllerConfig,
    KeepConfig,
    ReplayConfig,
    RingConfig,
    StationConfig,
)
from vaoi_station.demo.station_files import to_toml
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.simulation import Scenario, Twin, read_scenario
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.simulation.scenario import LostFrame

SCENARIO = Path(__file__).with_name("tiny.toml")
BOARDS = 3
"""Number of different boards without faults."""
SEQUENCE = 400
"""Number of boards after which the sequence repeats."""
KEPT_RUNS = 1500
"""Number of runs of which at least the summary is kept."""
LOST_FROM_ROW = 2
"""First row that is missing when a camera is lost while a board passes."""


@dataclass(frozen=True)
class Pace:
    """How fast boards come, and how often a camera is lost while one passes."""

    pause_s: float
    lost_share: float = 0.0
    seed: int = 0


def write_line_files(folder: Path, data: Path, pace: Pace) -> Path:
    """Write recordings, calibration, board type and station.toml; return the path of station.toml."""
    scenario = read_scenario(SCENARIO)
    twin = Twin(scenario)
    good = [folder / f"board-{number}" for number in range(BOARDS)]
    for number, path in enumerate(good):
        write_passage(twin.passage(number), path)
    lost = [folder / f"lost-{camera}" for camera in range(scenario.array.cameras)]
    for camera, path in enumerate(lost):
        write_passage(_without(scenario, camera).passage(0), path)
    chance = random.Random(pace.seed)
    order = [chance.choice(lost if chance.random() < pace.lost_share else good) for _ in range(SEQUENCE)]
    # The first board is one without faults: the latency of the cameras is learnt from it.
    recordings = (good[0], *order[1:])
    write_calibration(folder / "calibration.json", twin.calibration)
    write_board_type(folder / "board-types" / "tiny.json", twin.board_type)
    (folder / "shm").mkdir()
    array = scenario.array
    config = StationConfig(
        name="soak",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=data,
        line=twin.line,
        cameras=tuple(
            CameraConfig(
                name=f"camera {n}", backend="replay", width=array.width_px, height=array.height_px,
                exposure_us=array.exposure_us(n),
            )
            for n in range(array.cameras)
        ),
        controller=ControllerConfig(backend="replay"),
        replay=ReplayConfig(recordings=recordings, pace="original", pause_s=pace.pause_s),
        ring=RingConfig(directory=folder / "shm", runs=6, keep_s=0.1),
        # Limits that are reached while the soak lasts: what is deleted, and what grows without end, is then seen.
        keep=KeepConfig(results=300, doubtful_results=100, runs=KEPT_RUNS, database_gb=0.05, recordings_gb=0.01),
    )  # fmt: skip
    path = folder / "station.toml"
    path.write_text(to_toml(config), encoding="utf-8")
    return path


def _without(scenario: Scenario, camera: int) -> Twin:
    """Return a twin of which one camera delivers nothing after its first rows."""
    rows = len(Twin(scenario).passage(0).pulse_times_s)
    lost = tuple(LostFrame(camera=camera, row=row) for row in range(LOST_FROM_ROW, rows))
    faults = scenario.faults.model_copy(update={"lost_frames": lost})
    return Twin(scenario.model_copy(update={"faults": faults}))
