"""A camera in the place of another: found from one board by its neighbours, which are held; and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.drift.test_recalibrate import error_px
from vaoi_station.calibration.exchanged_camera import with_camera, without_place
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.recalibrate import calibrate_exchanged
from vaoi_station.errors import InputError
from vaoi_station.geometry import Projective, System
from vaoi_station.model import Calibration, Status, Stitch
from vaoi_station.simulation import Twin
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

Made = Callable[..., RunCheck]


class Film:
    """A board under a camera that hangs elsewhere than its predecessor, stitched with any calibration."""

    def __init__(self, twin: Twin) -> None:
        self.twin, self.passage = twin, twin.passage(0)
        self._head, self._frames = self.passage.head(), self.passage.render_all()

    def stitched(self, calibration: Calibration) -> tuple[RunCheck, Stitch]:
        head, frames, times_s = self._head, self._frames, self._head.row_times_s()
        cameras = calibration.cameras(self.twin.heads)
        setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, self.twin.board_type)
        runner, present = TaskRunner(setup, lambda i, j: frames.get((i, j))), sorted(frames)
        evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
        stitch, findings = runner.conclude_with_findings(times_s, present, evidence)
        return check_run("run 0", "", "small", findings), stitch


@pytest.fixture(scope="module")
def film(knocked_twin: Callable[..., Twin]) -> Film:
    knocks: list[dict[str, Any]] = [
        {"camera": 1, "about": about, "angle_deg": angle} for about, angle in (("x", -0.4), ("y", 0.3), ("z", -0.4))
    ]
    return Film(knocked_twin(*knocks))


def test_one_board_calibrates_the_new_camera_and_holds_the_others(film: Film) -> None:
    before = film.twin.calibration
    assert (before.uncalibrated, error_px(before, film.passage, 1) > 30) == ((), True)
    vague = without_place(before, 1)
    assert vague.uncalibrated == (1,)
    check, stitch = film.stitched(vague)
    assert stitch.status is Status.DEGRADED
    assert "camera-not-calibrated" in stitch.reason_codes
    made = calibrate_exchanged(vague, film.twin.heads, [check]).calibration
    assert error_px(made, film.passage, 1) < 0.06
    for held in (0, 2):
        assert (made.camera_matrices[held] == before.camera_matrices[held]).all()
    assert made.uncalibrated == ()
    assert made.covariance is not None
    sigma_px = np.sqrt(np.diag(made.covariance[1])[:3])
    assert (sigma_px < 0.1).all(), "the uncertainty is that of the board"
    assert film.stitched(made)[1].status is Status.OK


def test_what_a_displacement_does_not_explain_is_refused(made: Made, knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin()
    vague = without_place(twin.calibration, 1)

    def check(**camera: object) -> RunCheck:
        run = made(0, [(0.0, 0.0, 0.0), (20.0, -8.0, 1.0), (0.0, 0.0, 0.0)])
        new = run.cameras[1].model_copy(update=camera)
        return run.model_copy(update={"cameras": (run.cameras[0], new, run.cameras[2])})

    proposal = calibrate_exchanged(vague, twin.heads, [check()])
    assert proposal.found.displacement_px[1] == pytest.approx((20.0, -8.0, 1.0), abs=0.01)
    with pytest.raises(InputError, match=r"camera 1 does not see as its predecessor did.*1\.20 px rms remain"):
        calibrate_exchanged(vague, twin.heads, [check(left_px=1.2)])
    with pytest.raises(InputError, match=r"camera 1 has 3 links .* 0 fiducials \(needed: 1\)"):
        calibrate_exchanged(vague, twin.heads, [check(links=3)])
    moved = made(0, [(0.0, 0.0, 0.0), (20.0, -8.0, 1.0), (3.0, 0.0, 0.0)])
    with pytest.raises(InputError, match=r"camera 2 has moved as well, by 3\.00 px"):
        calibrate_exchanged(vague, twin.heads, [moved])
    with pytest.raises(InputError, match="All cameras are calibrated"):
        calibrate_exchanged(twin.calibration, twin.heads, [moved])


def test_after_the_camera_was_touched_the_latest_two_boards_count(
    made: Made, knocked_twin: Callable[..., Twin]
) -> None:
    twin = knocked_twin()
    vague = without_place(twin.calibration, 1)

    def run(number: int, x_px: float) -> RunCheck:
        return made(number, [(0.0, 0.0, 0.0), (x_px, -8.0, 1.0), (0.0, 0.0, 0.0)])

    with pytest.raises(InputError, match="the runs disagree about camera 1") as refused:
        calibrate_exchanged(vague, twin.heads, [run(0, 20.0), run(1, 24.0)])
    assert (refused.value.action or "").startswith("Let more boards pass")
    proposal = calibrate_exchanged(vague, twin.heads, [run(0, 20.0), run(1, 24.0), run(2, 24.0)])
    assert proposal.found.displacement_px[1] == pytest.approx((24.0, -8.0, 1.0), abs=0.01)


def test_a_calibration_board_that_lay_elsewhere_calibrates_the_new_camera_alone(
    knocked_twin: Callable[..., Twin],
) -> None:
    twin = knocked_twin()
    before, moved = twin.calibration, np.array([[0.999998, -0.002, 3.0], [0.002, 0.999998, -1.5], [0, 0, 1.0]])
    truly = list(before.camera_matrices)
    truly[1] = np.array([[1, 0.003, 12.0], [-0.003, 1, -7.0], [0, 0, 1]]) @ truly[1]
    # The board lay elsewhere, so that all matrices of the new calibration differ from those in force.
    new = before.model_copy(update={"camera_matrices": tuple(m @ moved for m in truly)})
    made, rms_px = with_camera(without_place(before, 1), new, twin.heads, 1)
    assert rms_px < 0.01
    points = np.array([(0.0, 0.0), (10.0, 5.0), (-8.0, 12.0)])
    ours, wanted = (Projective(m, System.IMAGE, System.ROW)(points) for m in (made.camera_matrices[1], truly[1]))
    assert np.abs(ours - wanted).max() < 0.02
    assert (made.camera_matrices[0] == before.camera_matrices[0]).all()
    assert made.uncalibrated == ()
    shifted = list(new.camera_matrices)
    shifted[2] = np.array([[1, 0, 1.5], [0, 1, 0], [0, 0, 1]]) @ shifted[2]
    with pytest.raises(InputError, match=r"which is to be held, differs by"):
        with_camera(before, new.model_copy(update={"camera_matrices": tuple(shifted)}), twin.heads, 1)
