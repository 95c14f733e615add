"""Boards of a small twin of three cameras, filmed and checked; one camera may be knocked from a board on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import CameraCheck, RunCheck
from vaoi_station.simulation import Scenario, Twin, read_scenario
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

SCENARIO = read_scenario(Path(__file__).parent / "three.toml").model_dump()


def twin_with(*knocks: dict[str, Any]) -> Twin:
    return Twin(Scenario.model_validate({**SCENARIO, "faults": {"knocked": knocks}}))


def checked(twin: Twin, board: int) -> RunCheck:
    """Film a board, stitch it, and make its check."""
    passage = twin.passage(board)
    head, frames = passage.head(), passage.render_all()
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    times_s, present = head.row_times_s(), sorted(frames)
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    _, findings = runner.conclude_with_findings(times_s, present, evidence)
    return check_run(f"run {board}", f"2026-01-01T00:00:{board:02d}Z", "small", findings)


@pytest.fixture(scope="session")
def film() -> Callable[[Twin, int], RunCheck]:
    return checked


@pytest.fixture(scope="session")
def knocked_twin() -> Callable[..., Twin]:
    return twin_with


@pytest.fixture(scope="session")
def undisturbed() -> list[RunCheck]:
    """Four boards under cameras that have not moved."""
    twin = twin_with()
    return [checked(twin, board) for board in range(4)]


Shown = list[tuple[float, float, float]]


def check(run: int, shown: Shown, sigma_px: float = 0.02, board_type: str = "a") -> RunCheck:
    """Make a run in which the cameras show these displacements."""
    size = 3 * len(shown)
    information = np.eye(size) / sigma_px**2
    cameras = tuple(
        CameraCheck(x_px=x, y_px=y, turn_px=t, sigma_px=(sigma_px,) * 3, rms_px=0.1, left_px=0.1, links=40, fiducials=0)
        for x, y, t in shown
    )
    return RunCheck(
        run=f"r{run:03d}",
        time=f"t{run:03d}",
        board_type=board_type,
        cameras=cameras,
        rivals=(),
        information=tuple(information[np.tril_indices(size)]),
        vector=tuple((np.ravel(shown) / sigma_px**2).tolist()),
    )


@pytest.fixture(scope="session")
def made() -> Callable[..., RunCheck]:
    return check
