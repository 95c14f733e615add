"""Displacements, residuals and counts per camera of a stitched run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.drift.estimate import DisplacementEstimate, estimate_displacements
from vaoi_station.simulation import Twin
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks


def stitched(twin: Twin, *, with_board: bool = True) -> Findings:
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    board_type = twin.board_type if with_board else None
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, board_type)
    times_s, present = head.row_times_s(), sorted(frames)
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    return runner.conclude_with_findings(times_s, present, evidence)[1]


@pytest.fixture(scope="module")
def knocked(knocked_twin: Callable[..., Twin]) -> Findings:
    return stitched(knocked_twin({"camera": 1, "about": "y", "angle_deg": 0.02}))


def predicted(estimate: DisplacementEstimate, d: np.ndarray) -> float:
    """Compute the largest violation of information · d = vector, in standard deviations of each equation."""
    left = estimate.information @ d.ravel() - estimate.vector
    return float((np.abs(left) / np.sqrt(np.diag(estimate.information))).max())


def test_the_residuals_of_a_knocked_camera_are_explained(knocked: Findings) -> None:
    found = estimate_displacements(knocked)
    assert found.rms_px[1] > 0.5
    assert found.left_px.max() < 0.3 * found.rms_px[1]
    assert knocked.adjusted.cameras is not None
    assert predicted(found, knocked.adjusted.cameras.displacement_px) < 1
    assert predicted(found, np.zeros((3, 3))) > 3


def test_without_a_board_type_the_links_alone_show_the_knock(knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin({"camera": 1, "about": "x", "angle_deg": 0.02})
    found = estimate_displacements(stitched(twin, with_board=False))
    assert not found.fiducials.any()
    assert found.left_px.max() < 0.5 * found.rms_px[1]


def test_a_run_with_exact_cameras_is_no_evidence(knocked: Findings) -> None:
    mapping = knocked.mapping
    assert mapping is not None
    exact = replace(mapping, adjusted=replace(knocked.adjusted, cameras=None))
    found = estimate_displacements(replace(knocked, found=exact))
    assert not found.information.any()
    assert not found.links.any()
    assert np.isnan(found.rms_px).all()
