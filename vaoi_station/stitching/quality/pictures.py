"""Faults of the cameras' pictures: distortion that the calibration does not contain, and blur."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.marks.blur import BLUR_LIMIT_PX, measure_blur_px
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import Scene

_LEAST_LINKS, _LEAST_WEIGHT = 40, 0.1
"""Least number of links by which the distortion of a camera is estimated, and least robust weight of each."""
_STABLE = 1e-9
"""Share of the normal matrix's trace that is added to its diagonal: links in one line do not determine a turn."""
_SHARE = 0.2
"""Rms error of a position, per axis, divided by the radial error at the corner. Measured: 0.15 to 0.25."""
_SIGNIFICANT = 4.0
"""Number of standard deviations from which on an error counts as more than noise."""
_LIMIT_PX = 0.4
"""Largest accepted radial error at the corners of a picture. Positions are then wrong by a fifth of it, rms."""


class LensError(NamedTuple):
    """The radial error of one camera's picture, estimated from the links of a run."""

    corner_px: float
    """Displacement of a corner of the picture by the error, px; positive if it points away from the middle."""
    sigma_px: float

    @property
    def significant(self) -> bool:
        """Whether the error is larger than noise explains."""
        return abs(self.corner_px) > _SIGNIFICANT * self.sigma_px

    @property
    def beyond_noise_px2(self) -> float:
        """Square of the error less what noise explains; negative if noise explains it."""
        return self.corner_px**2 - 4 * self.sigma_px**2


def lens_errors(problem: Problem, adjusted: AdjustmentResult, cameras: tuple[Camera, ...]) -> dict[int, LensError]:
    """Estimate the radial error of every camera that has enough links from row to row.

    No other check notices a distortion that a calibration without covariance leaves out. It displaces a point of the
    board differently at two places of the picture. What the adjustment can explain in each pair of frames is eliminated
    first: shift and turn of the row, and tilt of the board.
    """
    o = problem.links
    use = np.flatnonzero((o.p != o.q) & (adjusted.weight > _LEAST_WEIGHT))
    if not len(use):
        return {}
    _, first, pair = np.unique(o.group[use], return_index=True, return_inverse=True)
    camera = o.camera_a[use]
    centre_mm = np.array([c.ground(np.array([c.center_px]))[0] for c in cameras])[camera]
    radius_mm = np.array([float(np.hypot(*c.center_px)) / c.px_per_mm for c in cameras])[camera, None]
    a, b = (o.a_mm[use] - centre_mm) / radius_mm, (o.b_mm[use] - centre_mm) / radius_mm
    off, lean = o.a_mm[use] - o.a_mm[use][first][pair], o.b_lean[use] - o.a_lean[use]
    # Derivatives (k, 2, 6) by shift x and y, turn, tilt along x and y, and the error at the corner.
    j = np.zeros((len(use), 2, 6))
    j[:, 0, 0] = j[:, 1, 1] = 1.0
    j[:, 0, 2], j[:, 1, 2], j[:, :, 3:5] = -off[:, 1], off[:, 0], lean[:, :, None] * off[:, None]
    j[:, :, 5] = b * (b**2).sum(1)[:, None] - a * (a**2).sum(1)[:, None]
    weight = adjusted.weight[use][:, None, None] * o.inverse_noise(use, adjusted.floor_px)
    # On a component, the residual along the lean is explained by its height.
    raised = (problem.reaches_component | (problem.component >= 0))[use]
    pull = (weight @ lean[:, :, None])[:, :, 0]
    along = (pull * lean).sum(1)
    weight -= np.where(raised & (along > 0), 1 / np.where(along > 0, along, 1.0), 0.0)[:, None, None] * (
        pull[:, :, None] * pull[:, None]
    )
    weighted, residual_mm = weight @ j, (adjusted.link_px / o.px_per_mm[:, None])[use]
    square = np.add.reduceat(j.swapaxes(1, 2) @ weighted, first)
    product = np.add.reduceat((residual_mm[:, None] @ weighted)[:, 0], first)
    own = square[:, :5, :5] + _STABLE * np.trace(square[:, :5, :5], axis1=1, axis2=2)[:, None, None] * np.eye(5)
    follow = np.linalg.solve(own, square[:, :5, 5:])[:, :, 0]
    by_pair = square[:, 5, 5] - (follow * square[:, :5, 5]).sum(1), product[:, 5] - (follow * product[:, :5]).sum(1)
    information, estimate = (np.bincount(camera[first], values, len(cameras)) for values in by_pair)
    count = np.bincount(camera, minlength=len(cameras))
    return {
        i: LensError(float(estimate[i] / information[i]) * c.px_per_mm, float(information[i] ** -0.5) * c.px_per_mm)
        for i, c in enumerate(cameras)
        if count[i] >= _LEAST_LINKS and information[i] > 0
    }


def position_errors_px(errors: Mapping[int, LensError], cameras: int) -> dict[int, float]:
    """Return for each camera the rms error of a position, px per axis, that radial errors cause; empty without any."""
    every = [(e.beyond_noise_px2, e.sigma_px**-4.0) for e in errors.values()]
    shown = sum(px2 * weight for px2, weight in every) / sum(weight for _, weight in every) if every else 0.0
    out = {}
    for i in range(cameras):
        own = errors.get(i)
        expected = max(shown, own.beyond_noise_px2 if own else 0.0, 0.0)
        if expected > 0:
            # The estimate, drawn to 0 by the variance that is expected of errors, and what is not known of it.
            share = expected / (expected + own.sigma_px**2) if own else 0.0
            known = share * own.corner_px if own else 0.0
            out[i] = _SHARE * float(np.sqrt(known**2 + (1 - share) * expected))
    return out


def lens_reasons(errors: Mapping[int, LensError]) -> Iterator[Reason]:
    """Yield a reason for every camera whose lens is distorted more than its calibration states."""
    for i, error in errors.items():
        if error.significant and abs(error.corner_px) > _LIMIT_PX:
            yield Reason(
                ReasonCode.LENS_DIFFERS,
                f"the picture of camera {i} is distorted against its calibration, by {error.corner_px:+.2f} ± "
                f"{error.sigma_px:.2f} px at the corners (limit {_LIMIT_PX}): the calibration leaves out the "
                "distortion of this lens, or focus or lens were changed since; calibrate again",
            )


def camera_blurs(plane: BoardPlane, scene: Scene, points: FiducialPoints) -> dict[int, float]:
    """Return for each camera that shows a fiducial the blur of the sharpest one, px (standard deviation of an edge)."""
    blurs, board = dict[int, float](), plane.board_type
    for n in np.flatnonzero(points.which >= 0).tolist():
        key = (int(points.camera[n]), int(points.row[n]))
        camera = scene.cameras[key[0]]
        size_px = board.fiducials[points.which[n]].diameter * board.mm_per_unit * camera.px_per_mm
        blur = measure_blur_px(scene.prepared(key).grey, camera.project(points.ground_mm[n : n + 1]), size_px)
        blurs[key[0]] = min(blur, blurs.get(key[0], np.inf))
    return blurs


def blur_reasons(blurs: Mapping[int, float]) -> list[Reason]:
    """Return a reason that names the cameras whose pictures are blurred beyond the limit."""
    blurred = {camera: px for camera, px in sorted(blurs.items()) if px > BLUR_LIMIT_PX}
    if not blurred:
        return []
    which = ", ".join(f"camera {camera} by {px:.1f} px" for camera, px in blurred.items())
    text = (
        f"pictures are blurred at the edges of fiducials: {which} (standard deviation, limit {BLUR_LIMIT_PX} px); "
        "focus the lens, lay the board at the height for which it was focused, or film it with a shorter exposure"
    )
    return [Reason(ReasonCode.PICTURES_BLURRED, text)]
