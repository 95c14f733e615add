"""Correction of N_i from production runs: a proposal with its uncertainty, or a refusal that states the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vaoi_station.drift.checks import RunCheck, combine_runs
from vaoi_station.drift.watch import LEAST_PX
from vaoi_station.errors import InputError
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS, displace_camera, rms_displacement_px
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Calibration, CameraHead
from vaoi_station.stitching.adjustment.cameras import Attribution

LEAST_RUNS, MOST_RUNS = 3, 50
LEAST_LINKS = 30
"""Least number of links from one camera to its neighbours, over all runs."""
_SIGMAS = 4.0
_KNOWN_PX = 0.25
"""A displacement is corrected only if the standard deviations of its x, y and turn are at most this."""
_AGREE_PX, _AGREE_SIGMAS = 0.15, 5.0
"""Largest accepted difference between the displacement by one run and that by all runs.

It is stated in px and in standard deviations; the larger of the two is the limit."""
_STEP_PX = 0.05


@dataclass(frozen=True, eq=False)
class Proposal:
    """A corrected calibration and the evidence for it."""

    calibration: Calibration
    found: Attribution
    corrected: tuple[int, ...]
    """Cameras whose N_i changes."""
    before_px: tuple[float | None, ...]
    """Per camera: rms residual of links to neighbouring cameras and of fiducials, under the calibration in force."""
    after_px: tuple[float | None, ...]
    """Per camera: rms of the same residuals after the estimated displacements are applied."""
    runs: int
    """Number of runs that were used."""

    def lines(self) -> list[str]:
        """Describe the proposal in one line per camera."""
        lines = []
        for i, (d, sigma) in enumerate(zip(self.found.displacement_px, self.found.sigma_px, strict=True)):
            x, y, turn = d
            what = (
                f"its picture moved by ({x:+.3f}, {y:+.3f}) px, and by {turn:+.3f} px at its corners by a turn "
                f"(± {sigma[0]:.3f}, {sigma[1]:.3f}, {sigma[2]:.3f}); N is corrected"
                if i in self.corrected
                else "has not moved; its N stays"
            )
            lines.append(f"camera {i}: residuals {_px(self.before_px[i])} → {_px(self.after_px[i])} px rms; {what}")
        if self.found.rivals:
            others = ", ".join(str(i) for i in self.found.rivals)
            lines.append(
                f"it is also possible that camera {others} moved, in the opposite direction: pictures of boards show "
                "only how cameras moved relative to one another. Stitching gives the same result in both cases."
            )
        return lines


def recalibrate(calibration: Calibration, heads: Sequence[CameraHead], checks: Sequence[RunCheck]) -> Proposal:
    """Propose a calibration with corrected N_i of the cameras that have moved.

    `checks` are those of runs that were stitched with the calibration, oldest first. `InputError`: there are too few
    runs or links, no run shows one of the cameras, or runs contradict one another.
    """
    cameras = calibration.cameras(tuple(heads))
    _refuse_too_little(checks, len(cameras))
    found = combine_runs(checks)
    # Only cameras that have clearly moved are corrected. The others keep their N_i to the last digit.
    corrected = tuple(i for i in range(len(cameras)) if _has_moved(found, i))
    for i in corrected:
        _refuse_vague(found, i)
        _refuse_contradictions(checks, found, i)
    matrices, covariances = list(calibration.camera_matrices), calibration.covariances
    if isinstance(covariances, list):
        covariances = [_widened(c, cameras[i], found, i) if i in corrected else c for i, c in enumerate(covariances)]
    known = calibration.covariance
    if known is not None:
        known = tuple(_with_displacement(c, found, i) if i in corrected else c for i, c in enumerate(known))
    for i in corrected:
        matrices[i] = displace_camera(cameras[i], found.displacement_px[i]).image_from_row.matrix
    made = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    update = {"camera_matrices": tuple(matrices), "covariances": covariances, "covariance": known, "created": made}
    before_px, after_px = (_rms_of(checks, key) for key in ("rms_px", "left_px"))
    return Proposal(calibration.model_copy(update=update), found, corrected, before_px, after_px, len(checks))


def _has_moved(found: Attribution, i: int) -> bool:
    d = found.displacement_px[i]
    at = slice(PARAMETERS * i, PARAMETERS * (i + 1))
    # Mahalanobis distance, because the three numbers are not equally accurate and their errors are correlated.
    distance = float(np.sqrt(d @ np.linalg.solve(found.covariance[at, at], d)))
    return rms_displacement_px(d) >= LEAST_PX and distance > _SIGMAS


def _refuse_too_little(checks: Sequence[RunCheck], cameras: int) -> None:
    if cameras < 2:
        raise InputError(
            "an array of one camera has no neighbours to compare it with.",
            action="Calibrate it with the calibration board.",
            code="too-little-evidence",
        )
    if len(checks) < LEAST_RUNS:
        raise InputError(
            f"{len(checks)} run(s) are too few to correct a calibration; at least {LEAST_RUNS} are needed.",
            action="Let more boards pass, or give more recordings.",
            code="too-little-evidence",
        )
    for i in range(cameras):
        links = sum(check.cameras[i].links for check in checks)
        marks = sum(check.cameras[i].fiducials for check in checks)
        if links < LEAST_LINKS and marks < LEAST_RUNS:
            raise InputError(
                f"camera {i} has {links} links to its neighbours (needed: {LEAST_LINKS}) and saw {marks} fiducials "
                f"(needed: {LEAST_RUNS}) in {len(checks)} runs: its position is unknown.",
                action="Take runs of boards that this camera shows, or calibrate with the calibration board.",
                code="too-little-evidence",
            )


def _refuse_vague(found: Attribution, i: int) -> None:
    """Raise InputError if the displacement of camera i is known too poorly for a correction."""
    # The camera has few links to its neighbours, so the height of the boards may look like a displacement.
    sigma = found.sigma_px[i]
    if sigma.max() > _KNOWN_PX:
        x, y, turn = found.displacement_px[i]
        raise InputError(
            f"camera {i} has moved, by ({x:+.2f}, {y:+.2f}) px and a turn of {turn:+.2f} px, but this is uncertain by "
            f"{sigma.max():.2f} px (1 σ, limit {_KNOWN_PX}): its overlaps with other cameras show too little texture.",
            action="Set the camera back roughly, or take more runs of boards with texture there, or calibrate with the "
            "calibration board.",
            code="too-little-evidence",
        )


def _refuse_contradictions(checks: Sequence[RunCheck], found: Attribution, i: int) -> None:
    """Raise InputError if one run gives another displacement of camera i than all runs together."""
    # If a camera was knocked between the runs, or its mount is loose, the runs have no common displacement. Their mean
    # would be wrong for all of them.
    worst: tuple[float, RunCheck] | None = None
    for check in checks:
        camera = check.cameras[i]
        if not camera.seen:
            continue
        limit = np.maximum(_AGREE_PX, _AGREE_SIGMAS * np.array(camera.sigma_px))
        off = float((np.abs(camera.displacement_px - found.displacement_px[i]) / limit).max())
        if off > 1 and (worst is None or off > worst[0]):
            worst = (off, check)
    if worst is not None:
        one, all_ = worst[1].cameras[i].displacement_px, found.displacement_px[i]
        raise InputError(
            f"the runs disagree about camera {i}: run {worst[1].run} gives ({one[0]:+.2f}, {one[1]:+.2f}) px, turn "
            f"{one[2]:+.2f}, all together ({all_[0]:+.2f}, {all_[1]:+.2f}) px, turn {all_[2]:+.2f}.",
            action="Use only runs since the camera moved (fewer --runs); if they disagree too, its mount is loose.",
            code="runs-disagree",
        )


def _widened(covariance: list[list[float]], camera: Camera, found: Attribution, i: int) -> list[list[float]]:
    """Return the covariance of camera i's N_i, increased by that of its displacement.

    The first eight parameters of this covariance are n11 to n32 of N_i. The parameters of the lens follow; their
    covariance is not changed.
    """

    def entries(d: Floats) -> Floats:
        m = displace_camera(camera, d).image_from_row.matrix
        return np.asarray((m / m[2, 2]).ravel()[:8])

    d = found.displacement_px[i]
    j = np.stack([(entries(d + s) - entries(d)) / _STEP_PX for s in np.eye(PARAMETERS) * _STEP_PX], -1)
    at = slice(PARAMETERS * i, PARAMETERS * (i + 1))
    wider = np.array(covariance, dtype=np.float64)
    wider[:8, :8] += j @ found.covariance[at, at] @ j.T
    return [[float(v) for v in row] for row in wider]


def _with_displacement(covariance: Floats, found: Attribution, i: int) -> Floats:
    """Return the covariance (9, 9) of a camera's error, with the accuracy of shift and turn after the correction."""
    # The correction replaces shift and turn, which are the first three fields, as the calibration knew them. Its
    # reference is the array as it was calibrated, so the covariances are added.
    at = slice(PARAMETERS * i, PARAMETERS * (i + 1))
    wider = np.array(covariance)
    wider[:PARAMETERS, :PARAMETERS] += found.covariance[at, at]
    return wider


def _rms_of(checks: Sequence[RunCheck], key: str) -> tuple[float | None, ...]:
    """Compute for each camera the root mean square, over the runs, of the value `key`; None if no run has it."""
    out = []
    for i in range(len(checks[0].cameras)):
        values = [v for check in checks if (v := getattr(check.cameras[i], key)) is not None]
        out.append(float(np.sqrt(np.mean(np.square(values)))) if values else None)
    return tuple(out)


def _px(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"
