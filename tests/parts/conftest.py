"""Boards of the twin, stitched: good ones, and one on which parts are absent."""

from __future__ import annotations

from functools import lru_cache

import pytest

from vaoi_station.parts.learned import TaughtBoard, parts_digest
from vaoi_station.parts.measure import Run
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.scenario import AbsentPart
from vaoi_station.stitching.work import StitchSetup, stitch_frames


@lru_cache(maxsize=8)
def stitched(board: int, absent: tuple[str, ...] = ()) -> Run:
    """Film and stitch one board of the twin's small scenario."""
    scenario = read_scenario(scenario_path("small"))
    faults = scenario.faults.model_copy(update={"absent_parts": tuple(AbsentPart(ref=ref) for ref in absent)})
    twin = Twin(scenario.model_copy(update={"faults": faults}))
    passage = twin.passage(board)
    head, frames = passage.head(), passage.render_all()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    result = stitch_frames(setup, head, lambda i, j: frames.get((i, j)))
    return Run(twin.board_type, result, cameras, head, lambda i, j: frames.get((i, j)))


def taught(run: Run, name: str, calibration: str = "c") -> TaughtBoard:
    """Teach a run as a good board."""
    return TaughtBoard.of_run(name, run.cut(run.board_type.components), parts_digest(run.board_type), calibration)


@pytest.fixture(scope="session")
def good_boards() -> tuple[TaughtBoard, ...]:
    """Two good boards."""
    return tuple(taught(stitched(n), f"good-{n}") for n in range(2))
