"""Cameras of the twin knocked by 0.1°: found, reported, corrected; and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.recalibrate import recalibrate
from vaoi_station.drift.watch import find_drifts
from vaoi_station.errors import InputError
from vaoi_station.model import Calibration
from vaoi_station.simulation import Passage, Twin

Film = Callable[[Twin, int], RunCheck]
Made = Callable[..., RunCheck]


def error_px(calibration: Calibration, passage: Passage, camera: int) -> float:
    """Of N_i over the whole frame, rms, against the camera as it hangs."""
    ours, truly = calibration.cameras(passage.twin.heads)[camera], passage.pinholes[camera]
    x, y = np.meshgrid(np.linspace(0, ours.width_px - 1, 9), np.linspace(0, ours.height_px - 1, 7))
    grid = np.column_stack([x.ravel(), y.ravel()])
    return float(np.sqrt(((ours.project(truly.ground(grid, 0.0)) - grid) ** 2).sum(1).mean()))


@pytest.mark.parametrize(("about", "before_px"), [("x", 7.3), ("y", 7.3), ("z", 0.34)])
def test_a_knock_by_a_tenth_of_a_degree_is_found_and_corrected(
    about: str, before_px: float, undisturbed: list[RunCheck], knocked_twin: Callable[..., Twin], film: Film
) -> None:
    twin = knocked_twin({"camera": 1, "about": about, "angle_deg": 0.1, "from_board": 4})
    since = [film(twin, board) for board in range(4, 7)]
    assert find_drifts(undisturbed) == ()
    (drift,) = find_drifts([*undisturbed, *since[:2]])
    assert (drift.camera, drift.since_run) == (1, "run 4")
    proposal = recalibrate(twin.calibration, twin.heads, since)
    passage = twin.passage(6)
    assert proposal.corrected == (1,)
    assert error_px(twin.calibration, passage, 1) == pytest.approx(before_px, rel=0.1)
    assert error_px(proposal.calibration, passage, 1) < 0.04
    assert (proposal.calibration.camera_matrices[0] == twin.calibration.camera_matrices[0]).all()


def test_unmoved_cameras_keep_their_matrices(undisturbed: list[RunCheck], knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    proposal = recalibrate(twin.calibration, twin.heads, undisturbed)
    assert proposal.corrected == ()
    assert np.abs(proposal.found.displacement_px).max() < 0.02
    assert "camera 2" in proposal.lines()[2]
    assert "has not moved" in proposal.lines()[2]


def test_too_few_runs_are_refused(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    with pytest.raises(InputError, match=r"2 run\(s\) are too few .* at least 3"):
        recalibrate(twin.calibration, twin.heads, [made(k, [(0.0, 0.0, 0.0)] * 3) for k in range(2)])


def test_a_camera_without_evidence_is_refused_by_number(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    runs = [made(k, [(0.0, 0.0, 0.0)] * 3) for k in range(3)]
    blind = [
        r.model_copy(update={"cameras": (*r.cameras[:2], r.cameras[2].model_copy(update={"links": 3}))}) for r in runs
    ]
    with pytest.raises(InputError, match=r"camera 2 has 9 links .* 0 fiducials"):
        recalibrate(twin.calibration, twin.heads, blind)


def test_runs_before_and_after_a_knock_disagree(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    runs = [made(k, [(0.0, 0.0, 0.0), (3.0 if k > 1 else 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]) for k in range(6)]
    with pytest.raises(InputError, match=r"disagree about camera 1: run r00[01] gives") as refused:
        recalibrate(twin.calibration, twin.heads, runs)
    assert "fewer --runs" in (refused.value.action or "")
