"""Faults of the cameras' pictures: distortion that the calibration does not contain, and blur."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.blur import measure_blur_px
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints, Ints, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import Scene

_LEAST_LINKS, _LEAST_WEIGHT = 40, 0.1
"""Least number of links by which the distortion of a camera is estimated, and least robust weight of each."""
_MOST_LINKS = 8000
"""Largest number of links that are used, spread over all pairs of frames: they show errors of 0.02 px at corners."""
_STABLE = 1e-9
"""Share of the normal matrix's trace that is added to its diagonal: links in one line do not determine a turn."""
_SHARE = 0.2
"""Rms error of a position, per axis, divided by the radial error at the corner. Measured: 0.15 to 0.25."""
_SIGNIFICANT = 4.0
"""Number of standard deviations from which on an error counts as more than noise."""
_LIMIT_PX = 0.4
"""Largest accepted radial error at the corners of a picture. Positions are then wrong by a fifth of it, rms."""
_BLUR_LIMIT_PX = 2.4
"""Largest blur of a camera's pictures, px. Measured: none of 16 hostile drawings between 2 and 2.4 px and with no other
reason is wrong; one at 2.5 px is, at a σ that does not say it."""


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
    step = -(-len(use) // _MOST_LINKS)
    use = use[::step]
    # Links of one pair of frames are adjacent.
    first = np.flatnonzero(np.diff(o.group[use], prepend=-1))
    camera, many = o.camera_a[use], np.diff(first, append=len(use))
    centre_mm = np.array([c.ground(c.center_px) for c in cameras]).T[:, camera]
    radius_mm = np.array([float(np.hypot(*c.center_px)) / c.px_per_mm for c in cameras])[camera]
    a_mm, b_mm, lean, link_px = (_columns(v, use) for v in (o.a_mm, o.b_mm, o.b_lean - o.a_lean, adjusted.link_px))
    a, b = (a_mm - centre_mm) / radius_mm, (b_mm - centre_mm) / radius_mm
    off = a_mm - np.repeat(a_mm[:, first], many, axis=1)
    # Derivatives (5, 2, k) by turn, tilt along x and y, and the error at the corner; last the residual. The first two
    # unknowns are the shift along x and y, whose derivatives are 1 and 0.
    j = np.empty((5, 2, len(use)))
    j[0, 0], j[0, 1], j[1:3] = -off[1], off[0], lean * off[:, None]
    j[3], j[4] = b * (b[0] ** 2 + b[1] ** 2) - a * (a[0] ** 2 + a[1] ** 2), link_px / o.px_per_mm[use]
    xx, xy, yy = _weights(problem, adjusted, use, lean)
    square = np.empty((7, 7, len(first)))
    square[0, 0], square[0, 1], square[1, 1] = (np.add.reduceat(v, first) for v in (xx, xy, yy))
    for m, (x, y) in enumerate(j, 2):
        weighted_x, weighted_y = xx * x + xy * y, xy * x + yy * y
        square[0, m], square[1, m] = np.add.reduceat(weighted_x, first), np.add.reduceat(weighted_y, first)
        for n in range(2, m + 1):
            square[n, m] = np.add.reduceat(weighted_x * j[n - 2, 0] + weighted_y * j[n - 2, 1], first)
    low = np.tril_indices(7, -1)
    square[low] = square.swapaxes(0, 1)[low]
    square = np.ascontiguousarray(np.moveaxis(square, 2, 0))
    product = square[:, 6]
    own = square[:, :5, :5] + _STABLE * np.trace(square[:, :5, :5], axis1=1, axis2=2)[:, None, None] * np.eye(5)
    follow = np.linalg.solve(own, square[:, :5, 5:6])[:, :, 0]
    by_pair = square[:, 5, 5] - (follow * square[:, :5, 5]).sum(1), product[:, 5] - (follow * product[:, :5]).sum(1)
    information, estimate = (np.bincount(camera[first], values, len(cameras)) for values in by_pair)
    count = step * np.bincount(camera, minlength=len(cameras))
    return {
        i: LensError(float(estimate[i] / information[i]) * c.px_per_mm, float(information[i] ** -0.5) * c.px_per_mm)
        for i, c in enumerate(cameras)
        if count[i] >= _LEAST_LINKS and information[i] > 0
    }


def _columns(values: Floats, at: Ints) -> Floats:
    """Return the rows `at` (k,) of an array (n, 2) as columns (2, k)."""
    return np.ascontiguousarray(values.take(at, axis=0).T)


def _weights(problem: Problem, adjusted: AdjustmentResult, use: Ints, lean: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the weights (k,) xx, xy, yy of the residuals of the links `use`, mm⁻², by noise and robust weight.

    On a component, the residual along the `lean` (2, k) is explained by its height: it has no weight there.
    """
    o = problem.links
    noise, floor_mm2 = o.noise_mm2.reshape(-1, 4).take(use, axis=0), (adjusted.floor_px / o.px_per_mm[use]) ** 2
    xx, xy, yy = noise[:, 3] + floor_mm2, -noise[:, 1], noise[:, 0] + floor_mm2
    share = adjusted.weight[use] / (xx * yy - xy**2)
    xx, xy, yy = xx * share, xy * share, yy * share
    at = np.flatnonzero((problem.reaches_component | (problem.component >= 0))[use])
    x, y = lean[:, at]
    pull_x, pull_y = xx[at] * x + xy[at] * y, xy[at] * x + yy[at] * y
    along = pull_x * x + pull_y * y
    inverse = np.divide(1.0, along, out=np.zeros_like(along), where=along > 0)
    xx[at] -= inverse * pull_x**2
    xy[at] -= inverse * pull_x * pull_y
    yy[at] -= inverse * pull_y**2
    return xx, xy, yy


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
    """Return for each camera that shows a fiducial the blur of one, px (standard deviation of an edge).

    It is the first one within the limit, or the sharpest.
    """
    blurs, board = dict[int, float](), plane.board_type
    for n in np.flatnonzero(points.which >= 0).tolist():
        key = (int(points.camera[n]), int(points.row[n]))
        if blurs.get(key[0], np.inf) <= _BLUR_LIMIT_PX:
            continue
        camera = scene.cameras[key[0]]
        size_px = board.fiducials[points.which[n]].diameter * board.mm_per_unit * camera.px_per_mm
        blur = measure_blur_px(scene.prepared(key).grey, camera.project(points.ground_mm[n : n + 1]), size_px)
        blurs[key[0]] = min(blur, blurs.get(key[0], np.inf))
    return blurs


def blur_reasons(blurs: Mapping[int, float]) -> list[Reason]:
    """Return a reason that names the cameras whose pictures are blurred beyond the limit."""
    blurred = {camera: px for camera, px in sorted(blurs.items()) if px > _BLUR_LIMIT_PX}
    if not blurred:
        return []
    which = ", ".join(f"camera {camera} by {px:.1f} px" for camera, px in blurred.items())
    text = (
        f"pictures are blurred at the edges of fiducials: {which} (standard deviation, limit {_BLUR_LIMIT_PX} px); "
        "focus the lens, lay the board at the height for which it was focused, or film it with a shorter exposure"
    )
    return [Reason(ReasonCode.PICTURES_BLURRED, text)]
