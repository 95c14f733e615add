"""Correction of N_i from production runs: a proposal with its uncertainty, or a refusal that states the numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vaoi_station.drift.checks import RunCheck, combine_runs, still_px
from vaoi_station.drift.watch import LEAST_PX
from vaoi_station.errors import InputError
from vaoi_station.geometry import Camera
from vaoi_station.geometry.camera_error import uncalibrated
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
_LEFT_PX, _LEFT_FACTOR = 0.3, 3.0
"""Largest accepted rms residual of an exchanged camera, px, and as a multiple of the smallest one of the others."""
_LEAST_AGREEING = 2
"""Least number of the latest runs that show an exchanged camera if those before disagree with them."""
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
    _refuse_too_little(checks, len(cameras), range(len(cameras)), LEAST_RUNS)
    found, new = combine_runs(checks, still_px(cameras)), uncalibrated(cameras)
    # Only cameras that have clearly moved are corrected. The others keep their N_i to the last digit.
    corrected = tuple(i for i in range(len(cameras)) if i in new or _has_moved(found, i))
    return _corrected(calibration, cameras, checks, found, corrected)


def calibrate_exchanged(calibration: Calibration, heads: Sequence[CameraHead], checks: Sequence[RunCheck]) -> Proposal:
    """Propose a calibration with N_i of the cameras that are not calibrated; one run may suffice. All others are held.

    `checks` are those of runs that were stitched with the calibration. If they disagree, the latest ones count, at
    least two: the camera was touched in between. `InputError`: no camera is to be calibrated, the runs show too little,
    another camera has moved as well, or the camera sees otherwise than its predecessor.
    """
    while True:
        try:
            return _calibrated(calibration, heads, checks)
        except InputError as refusal:
            if refusal.code != "runs-disagree":
                raise
            if len(checks) <= _LEAST_AGREEING:
                action = "Let more boards pass, and do not touch the camera. If they disagree too, its mount is loose."
                raise InputError(refusal.message, action=action, code=refusal.code) from refusal
            checks = checks[-max(_LEAST_AGREEING, len(checks) // 2) :]


def _calibrated(calibration: Calibration, heads: Sequence[CameraHead], checks: Sequence[RunCheck]) -> Proposal:
    cameras = calibration.cameras(tuple(heads))
    new = uncalibrated(cameras)
    if not new:
        raise InputError("All cameras are calibrated.", action="Use vaoi recalibrate.", code="nothing-exchanged")
    _refuse_too_little(checks, len(cameras), new, 1)
    found = combine_runs(checks, still_px(cameras))
    for i in range(len(cameras)):
        if i not in new and _has_moved(found, i):
            raise InputError(
                f"camera {i} has moved as well, by {rms_displacement_px(found.displacement_px[i]):.2f} px: it cannot "
                "be held.",
                action="Calibrate the whole array with the calibration board.",
                code="neighbours-moved",
            )
    proposal = _corrected(calibration, cameras, checks, found, new)
    for i in new:
        _refuse_other_view(proposal.after_px, i)
    return proposal


def _corrected(
    calibration: Calibration,
    cameras: tuple[Camera, ...],
    checks: Sequence[RunCheck],
    found: Attribution,
    corrected: tuple[int, ...],
) -> Proposal:
    """Return the proposal in which these cameras are displaced as found; `InputError` if that is too uncertain."""
    new = uncalibrated(cameras)
    for i in corrected:
        _refuse_vague(found, i)
        _refuse_contradictions(checks, found, i)
    matrices, covariances = list(calibration.camera_matrices), calibration.covariances
    if isinstance(covariances, list):
        covariances = [_widened(c, cameras[i], found, i) if i in corrected else c for i, c in enumerate(covariances)]
    known = calibration.covariance
    if known is not None:
        known = tuple(
            _with_displacement(c, found, i, new=i in new) if i in corrected else c for i, c in enumerate(known)
        )
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


def _refuse_too_little(checks: Sequence[RunCheck], cameras: int, which: Iterable[int], least_runs: int) -> None:
    if cameras < 2:
        raise InputError(
            "an array of one camera has no neighbours to compare it with.",
            action="Calibrate it with the calibration board.",
            code="too-little-evidence",
        )
    if len(checks) < least_runs:
        raise InputError(
            f"{len(checks)} run(s) are too few to correct a calibration; at least {least_runs} are needed.",
            action="Let more boards pass, or give more recordings.",
            code="too-little-evidence",
        )
    for i in which:
        links = sum(check.cameras[i].links for check in checks)
        marks = sum(check.cameras[i].fiducials for check in checks)
        if links < LEAST_LINKS and marks < least_runs:
            raise InputError(
                f"camera {i} has {links} links to its neighbours (needed: {LEAST_LINKS}) and saw {marks} fiducials "
                f"(needed: {least_runs}) in {len(checks)} runs: its position is unknown.",
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


def _refuse_other_view(after_px: Sequence[float | None], i: int) -> None:
    """Raise InputError if a displacement alone does not explain what an exchanged camera sees."""
    left, others = after_px[i], [px for k, px in enumerate(after_px) if k != i and px is not None]
    limit = max(_LEFT_PX, _LEFT_FACTOR * min(others, default=0.0))
    if left is not None and left > limit:
        raise InputError(
            f"camera {i} does not see as its predecessor did, moved: {left:.2f} px rms remain (limit {limit:.2f}).",
            action="Check lens, focus and distance of the camera, or calibrate with the calibration board.",
            code="camera-unlike",
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


def _with_displacement(covariance: Floats, found: Attribution, i: int, *, new: bool) -> Floats:
    """Return the covariance (9, 9) of a camera's error, with the accuracy of shift and turn after the correction.

    `new`: nothing was known of them before.
    """
    # The correction replaces shift and turn, which are the first three fields, as the calibration knew them. Its
    # reference is the array as it was calibrated, so the covariances are added.
    at = slice(PARAMETERS * i, PARAMETERS * (i + 1))
    wider = np.array(covariance)
    if new:
        wider[:PARAMETERS], wider[:, :PARAMETERS] = 0.0, 0.0
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
