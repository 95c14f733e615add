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


def test_covariances_grow_by_that_of_the_displacement(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    known = twin.calibration.model_copy(update={"covariances": [(1e-12 * np.eye(8)).tolist()] * 3})
    runs = [made(k, [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 0.0)]) for k in range(3)]
    proposal = recalibrate(known, twin.heads, runs)
    before, after = known.covariances, proposal.calibration.covariances
    assert after[0] == before[0]
    assert np.linalg.eigvalsh(np.array(after[1]) - before[1])[-1] > 1e-6
    sigma_px = proposal.found.sigma_px[1, 0]
    assert np.sqrt(after[1][2][2]) == pytest.approx(sigma_px, rel=0.2), "n13 is where the origin is seen"


def test_the_field_of_errors_grows_by_the_displacement_in_shift_and_turn(
    made: Made, knocked_twin: Callable[..., Twin]
) -> None:
    twin = knocked_twin()
    known = twin.calibration.model_copy(update={"covariance": (0.01 * np.eye(9),) * 3})
    runs = [made(k, [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 0.0)]) for k in range(3)]
    proposal = recalibrate(known, twin.heads, runs)
    assert proposal.calibration.covariance is not None
    unmoved, moved, _ = proposal.calibration.covariance
    np.testing.assert_array_equal(unmoved, 0.01 * np.eye(9))
    np.testing.assert_allclose(np.diag(moved)[:3] - 0.01, proposal.found.sigma_px[1] ** 2)
    np.testing.assert_array_equal(moved[3:], 0.01 * np.eye(9)[3:])


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


def test_a_single_camera_is_refused(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    alone = twin.calibration.model_copy(update={"camera_matrices": twin.calibration.camera_matrices[:1]})
    with pytest.raises(InputError, match="one camera"):
        recalibrate(alone, twin.heads[:1], [made(k, [(0.0, 0.0, 0.0)]) for k in range(5)])
