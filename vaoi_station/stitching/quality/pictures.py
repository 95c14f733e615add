"""Blur of the cameras' pictures, measured at the edges of fiducials.

In blurred pictures the patches of corners near the board's edge show the edge and what lies beyond it, and a last row
that few corners place is off by up to 1.5 px (seed 111791), beyond its σ. Such pictures serve no inspection either.

Estimate lens distortion that the calibration does not contain, from the links of a run.

If a calibration leaves out a distortion and states no covariance, positions are wrong and no other check notices it.
The links of one camera from row to row show the distortion: a point of the board appears at two places of the picture,
and the distortion displaces it differently at each. The radial error of every camera is estimated from the residuals of
these links. Before that, everything in each pair of frames that the adjustment can explain is removed: the shift and
the turn of the row, and the tilt of the board.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.blur import BLUR_LIMIT_PX, measure_blur_px
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints, Ints, LinkArrays, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import Scene

_LEAST_LINKS, _LEAST_WEIGHT = 40, 0.1
"""Least number of links by which the distortion of a camera is estimated, and least robust weight of each."""
_NUISANCES = 5
"""Number of unknowns of a pair of frames that are eliminated: shift x and y, turn, and tilt along x and y."""
_STABLE = 1e-9
"""Share of the normal matrix's trace that is added to its diagonal, so that the matrix can always be inverted.

Otherwise it could not be inverted if all links lie in one line, because such links do not determine the turn."""
_SHARE = 0.2
"""Rms error of a position, per axis, divided by the radial error at the corner.

With ρ, the distance from the middle relative to that of a corner, the rms of ρ³ over a frame is 0.3, and 0.12 after the
best scale is subtracted. Boards of the twin show 0.15 to 0.25."""
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


class _Radial(NamedTuple):
    """Ground positions of the pictures of n cameras, from which their radial errors are counted."""

    centre_mm: Floats
    """(n, 2) ground point in the middle of each picture."""
    radius_mm: Floats
    """(n,) distance of a corner of the picture from that point."""


class _Noise(NamedTuple):
    """The noise of k links, in the form that compiled functions take."""

    robust: Floats
    """(k,) robust weights of the links, 0 to 1."""
    floor_px: float
    """Noise floor of the links, px."""
    raised: NDArray[np.bool_]
    """(k,) whether each link may lie on a component, whose unknown height displaces the link along its lean."""


def lens_errors(problem: Problem, adjusted: AdjustmentResult, cameras: tuple[Camera, ...]) -> dict[int, LensError]:
    """Estimate the radial error of every camera that has enough links from row to row.

    Args:
        problem: the adjustment problem, as the displaced cameras see it.
        adjusted: its solution.
        cameras: the cameras.
    """
    o = problem.links
    use = np.flatnonzero((o.p != o.q) & (adjusted.weight > _LEAST_WEIGHT))
    raised = problem.reaches_component | (problem.component >= 0)
    radial = _Radial(
        np.array([c.ground(np.array([c.center_px]))[0] for c in cameras]),
        np.array([float(np.hypot(*c.center_px)) / c.px_per_mm for c in cameras]),
    )
    camera = o.pairs.a[o.group]
    residual_mm = adjusted.link_px / o.px_per_mm[:, None]
    noise = _Noise(adjusted.weight, adjusted.floor_px, raised)
    sums = _accumulate(o.arrays, use, camera, residual_mm, noise, radial)
    count = np.bincount(camera[use], minlength=len(cameras))
    found = {}
    for i, c in enumerate(cameras):
        information, product = sums[i].tolist()
        if count[i] >= _LEAST_LINKS and information > 0:
            # If a point appears too far out, the residual is positive where the second point is further out than the
            # first.
            found[i] = LensError(product / information * c.px_per_mm, information**-0.5 * c.px_per_mm)
    return found


def position_errors_px(errors: Mapping[int, LensError], cameras: int) -> dict[int, float]:
    """Return for each camera the rms error of a position, px per axis, that radial errors cause; empty without any.

    A calibration that leaves out the lens of one camera may leave out that of all. Cameras whose links show their own
    error badly, or not at all, therefore have that which the other cameras show.
    """
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


@compiled
def _accumulate(links: LinkArrays, use: Ints, camera: Ints, residual: Floats, noise: _Noise, radial: _Radial) -> Floats:
    """Return for each of n cameras the information about its radial error, and information times estimate: (n, 2).

    The error is the one at a corner of the picture, in mm. Links of one pair of frames are adjacent; shift, turn and
    tilt of each pair are eliminated.

    Args:
        links: all k links.
        use: indices of the links that are used, ascending.
        camera: (k,) camera of every link.
        residual: (k, 2) residuals, mm.
        noise: noise of the links.
        radial: ground positions of the cameras' pictures.
    """
    size = _NUISANCES + 1
    out, square, product = np.zeros((len(radial.radius_mm), 2)), np.zeros((size, size)), np.zeros(size)
    x, y = np.empty(size), np.empty(size)
    origin_x, origin_y = 0.0, 0.0
    for at in range(len(use)):
        n = use[at]
        i = camera[n]
        if at == 0 or links.group[use[at - 1]] != links.group[n]:
            square[:], product[:] = 0.0, 0.0
            origin_x, origin_y = links.a_mm[n, 0], links.a_mm[n, 1]
        u, v = links.a_mm[n, 0] - origin_x, links.a_mm[n, 1] - origin_y
        lean_x, lean_y = links.b_lean[n, 0] - links.a_lean[n, 0], links.b_lean[n, 1] - links.a_lean[n, 1]
        radius, centre_x, centre_y = radial.radius_mm[i], radial.centre_mm[i, 0], radial.centre_mm[i, 1]
        ax, ay = (links.a_mm[n, 0] - centre_x) / radius, (links.a_mm[n, 1] - centre_y) / radius
        bx, by = (links.b_mm[n, 0] - centre_x) / radius, (links.b_mm[n, 1] - centre_y) / radius
        in_a, in_b = ax * ax + ay * ay, bx * bx + by * by
        x[0], x[1], x[2], x[3], x[4], x[5] = 1.0, 0.0, -v, lean_x * u, lean_x * v, bx * in_b - ax * in_a
        y[0], y[1], y[2], y[3], y[4], y[5] = 0.0, 1.0, u, lean_y * u, lean_y * v, by * in_b - ay * in_a
        floor = (noise.floor_px / links.px_per_mm[n]) ** 2
        a, b, d = links.noise_mm2[n, 0, 0] + floor, links.noise_mm2[n, 0, 1], links.noise_mm2[n, 1, 1] + floor
        share = noise.robust[n] / (a * d - b * b)
        xx, xy, yy = share * d, -share * b, share * a
        if noise.raised[n]:
            # The residual along the lean is explained by the component's height.
            lx, ly = xx * lean_x + xy * lean_y, xy * lean_x + yy * lean_y
            along = lean_x * lx + lean_y * ly
            if along > 0:
                xx, xy, yy = xx - lx * lx / along, xy - lx * ly / along, yy - ly * ly / along
        for k in range(size):
            wx, wy = xx * x[k] + xy * y[k], xy * x[k] + yy * y[k]
            product[k] += wx * residual[n, 0] + wy * residual[n, 1]
            for m in range(k + 1):
                square[k, m] += wx * x[m] + wy * y[m]
        if at + 1 == len(use) or links.group[use[at + 1]] != links.group[n]:
            _eliminate(square, product)
            out[i, 0] += square[_NUISANCES, _NUISANCES]
            out[i, 1] += product[_NUISANCES]
    return out


@compiled
def _eliminate(square: Floats, product: Floats) -> None:
    """Eliminate shift, turn and tilt from the normal equations of one pair of frames, in place; lower triangle only."""
    small = 0.0
    for k in range(_NUISANCES):
        small += _STABLE * square[k, k]
    for k in range(_NUISANCES):
        pivot = square[k, k] + small
        if pivot <= 0:
            continue
        for m in range(k + 1, len(product)):
            share = square[m, k] / pivot
            product[m] -= share * product[k]
            for j in range(k + 1, m + 1):
                square[m, j] -= share * square[j, k]


def camera_blurs(plane: BoardPlane, scene: Scene, points: FiducialPoints) -> dict[int, float]:
    """Return for each camera that shows a fiducial the blur of the sharpest one, px (standard deviation of an edge).

    Args:
        plane: plane of the board type.
        scene: the cameras and frames.
        points: the observed points, of which the detections of fiducials are used.
    """
    blurs = dict[int, float]()
    board = plane.board_type
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
    return [
        Reason(
            ReasonCode.PICTURES_BLURRED,
            f"pictures are blurred at the edges of fiducials: {which} (standard deviation, limit {BLUR_LIMIT_PX} px); "
            "focus the lens, lay the board at the height for which it was focused, or film it with a shorter exposure",
        )
    ]
