"""The drift check of a run, made from the findings of its conclusion, for the station and for `vaoi recalibrate`."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.drift.checks import CameraCheck, LampCheck, RunCheck, still_px
from vaoi_station.drift.estimate import DisplacementEstimate, estimate_displacements
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import STILL_PX, attribute_motion
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.work import all_tasks


def check_run(run: str, time: str, board_type: str, findings: Findings, lamps: tuple[LampCheck, ...] = ()) -> RunCheck:
    """Return the displacements of all cameras as a finished run shows them; `board_type` is its name or digest."""
    still = still_px(findings.calibrated)
    return make_run_check(run, time, board_type, estimate_displacements(findings), lamps, still)


def check_recording(opened: OpenedRun) -> RunCheck:
    """Stitch a recording and check its cameras. The check has the recording's directory as its run id."""
    times_s, present = opened.recording.head.motion_times_s(), opened.present
    runner = opened.runner()
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), opened.setup)]
    _, findings = runner.conclude_with_findings(times_s, present, evidence)
    board_type = opened.setup.board_type
    digest = "" if board_type is None else board_type.filmed_digest()
    return check_run(str(opened.recording.directory), "", digest, findings)


def make_run_check(
    run: str,
    time: str,
    board_type: str,
    estimate: DisplacementEstimate,
    lamps: tuple[LampCheck, ...] = (),
    still: Floats | float = STILL_PX,
) -> RunCheck:
    """Make the stored check of a run from the estimate of its cameras' displacements, and the brightness."""
    found = attribute_motion(estimate.information, estimate.vector, still)
    cameras = []
    for i, (d, sigma) in enumerate(zip(found.displacement_px, found.sigma_px, strict=True)):
        x, y, turn = (round(float(v), 5) for v in d)
        sigma_x, sigma_y, sigma_turn = (round(float(v), 5) for v in sigma)
        rms, left = (None if math.isnan(v[i]) else round(float(v[i]), 5) for v in (estimate.rms_px, estimate.left_px))
        cameras.append(
            CameraCheck(
                x_px=x,
                y_px=y,
                turn_px=turn,
                sigma_px=(sigma_x, sigma_y, sigma_turn),
                rms_px=rms,
                left_px=left,
                links=int(estimate.links[i]),
                fiducials=int(estimate.fiducials[i]),
            )
        )
    return RunCheck(
        run=run,
        time=time,
        board_type=board_type,
        cameras=tuple(cameras),
        rivals=found.rivals,
        information=_short(estimate.information[np.tril_indices(len(estimate.vector))]),
        vector=_short(estimate.vector),
        lamps=lamps,
    )


def _short(values: Floats) -> tuple[float, ...]:
    # Seven digits: more than the estimate's accuracy needs, half as long as full precision.
    return tuple(float(f"{v:.7g}") for v in values)
