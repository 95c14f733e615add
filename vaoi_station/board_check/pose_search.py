"""Find where the bodies of a board type lie in the overview by their edges, and which bodies have edges there.

Quarter turns, mirrored or not, any shift and a small scale are tried. All shifts are tried at once by a Fourier
transform; the best ones are refined in shift, angle and scale at growing sharpness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.overview import Floats32, Overview
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import Ints
from vaoi_station.stitching.geometry import ComponentIndex

_STEP_MM = 0.25
_LEAST, _MOST = 3, 40
"""Least and largest number of points on one edge."""


@dataclass(frozen=True, eq=False)
class BodyEdges:
    """k points on the edges of bodies, in mm: CAD coordinates times the size of their unit."""

    points: Floats
    """(k, 2)."""
    normals: Floats
    """(k, 2) unit vectors across the edge."""
    part: Ints
    """(k,) number of the component in the board type, ascending."""
    weight: Floats
    """(k,) each component counts by the root of its perimeter."""

    @staticmethod
    def of(board_type: BoardType) -> BodyEdges:
        """Return the points of all components of a board type."""
        corners = ComponentIndex.of(board_type).corners * board_type.mm_per_unit
        sides = np.roll(corners, -1, axis=1) - corners
        lengths = np.hypot(sides[..., 0], sides[..., 1])
        counts = np.clip(np.ceil(lengths / _STEP_MM), _LEAST, _MOST).astype(np.int_)
        side = np.repeat(np.arange(counts.size), counts.ravel())
        starts = np.cumsum(counts.ravel()) - counts.ravel()
        share = (np.arange(len(side)) - starts[side] + 0.5) / counts.ravel()[side]
        along = sides.reshape(-1, 2)[side]
        normals = np.stack([along[:, 1], -along[:, 0]], 1) / lengths.ravel()[side, None]
        part, perimeter = side // 4, lengths.sum(1)
        # Points of an edge share its length, so that a long edge of few points counts as much.
        weight = lengths.ravel()[side] / counts.ravel()[side] / np.sqrt(perimeter[part])
        return BodyEdges(corners.reshape(-1, 2)[side] + share[:, None] * along, normals, part, weight)

    def of_parts(self, parts: Ints) -> BodyEdges:
        """Return the points of some components only."""
        keep = np.isin(self.part, parts)
        return BodyEdges(self.points[keep], self.normals[keep], self.part[keep], self.weight[keep])


_SEARCH_PX = 6e5
"""Largest number of pixels of the picture in which all shifts are tried."""
_SEARCH_BLUR_MM, _BLURS_MM = 0.35, (0.6, 0.3, 0.15)
_STEPS_MM = {0.6: (0.8, 0.4, 0.2), 0.3: (0.2, 0.1), 0.15: (0.1, 0.05, 0.02)}
"""Steps of the refinement at every blur: displacements at the rms distance of the bodies from their middle, mm."""
_MOST_ROUNDS = 30
_LINE = 1024
"""Number of points that are sampled in one line of a map."""
_GROUPS = 8
"""Number of groups of components, each of which is left out once to estimate the scatter of a pose."""


@dataclass(frozen=True)
class Pose:
    """A similarity from CAD data in mm to tester coordinates."""

    mirrored: bool
    """Whether the y axis is negated first."""
    angle_rad: float
    scale: float
    shift_mm: tuple[float, float]
    """Where the origin of the CAD data lies."""
    score: float = 0.0
    """Standard deviations by which the edges at this pose exceed those at random shifts."""

    @property
    def matrix(self) -> Floats:
        """Matrix (3, 3) from CAD data in mm to tester coordinates."""
        c, s = self.scale * np.cos(self.angle_rad), self.scale * np.sin(self.angle_rad)
        f = -1.0 if self.mirrored else 1.0
        return np.array([[c, -s * f, self.shift_mm[0]], [s, c * f, self.shift_mm[1]], [0, 0, 1.0]])


def find_poses(overview: Overview, edges: BodyEdges, angles_rad: Sequence[float]) -> list[Pose]:
    """Return the best pose of every quarter turn of angles of CAD data, as seen and mirrored; the best one first."""
    small = _reduced(overview)
    strength = small.edges(_SEARCH_BLUR_MM)
    found: list[Pose] = []
    # Poses that differ by half a turn or a mirror need the same room, so the picture is transformed twice in all.
    for upright in (0, 1):
        tried = [
            [Pose(mirrored, angle + quarter * np.pi / 2, 1.0, (0.0, 0.0)) for angle in angles_rad]
            for quarter, mirrored in product((upright, upright + 2), (False, True))
        ]
        extents = [np.ptp(edges.points @ pose.matrix[:2, :2].T, axis=0) for poses in tried for pose in poses]
        spectrum = _Spectrum.of(strength, np.max(extents, axis=0) * small.px_per_mm + 2)
        for poses in tried:
            shifted = [_best_shift(small, spectrum, edges, pose) for pose in poses]
            found.append(max(shifted, key=lambda pose: pose.score))
    return sorted(found, key=lambda pose: -pose.score)


def refine_pose(overview: Overview, edges: BodyEdges, pose: Pose) -> tuple[Pose, Floats]:
    """Return a pose with refined shift, angle and scale, and its covariance (4, 4).

    That is of shift x and y at the middle of the bodies, turn and stretch; turn and stretch are displacements at the
    rms distance of the bodies from their middle, mm.
    """
    for blur in _BLURS_MM:
        strength = overview.edges(blur)
        pose = _climbed(overview, strength, edges, pose, _STEPS_MM[blur])
    parts, steps = np.unique(edges.part), _STEPS_MM[_BLURS_MM[-1]]
    covariance = np.zeros((4, 4))
    if len(parts) >= _GROUPS:
        rests = [edges.of_parts(parts[np.arange(len(parts)) % _GROUPS != group]) for group in range(_GROUPS)]
        poses = [_climbed(overview, strength, rest, pose, steps[1:]) for rest in rests]
        changes = np.array([_difference(edges, pose, other) for other in poses])
        spread = changes - changes.mean(axis=0)
        covariance = (_GROUPS - 1) / _GROUPS * spread.T @ spread
    # The last step and the pixels of the picture bound what can be seen of a pose.
    return pose, covariance + np.eye(4) * (steps[-1] ** 2 + (0.1 / overview.px_per_mm) ** 2)


def _reduced(overview: Overview) -> Overview:
    factor = max(round(float(np.sqrt(overview.grey.size / _SEARCH_PX)) + 0.49), 2 if overview.px_per_mm > 5 else 1)
    if factor == 1:
        return overview
    h, w = (n // factor for n in overview.grey.shape)
    grey = cv2.resize(overview.grey[: h * factor, : w * factor], (w, h), interpolation=cv2.INTER_AREA)
    seen = overview.seen[: h * factor : factor, : w * factor : factor]
    low = overview.low_mm + (factor - 1) / 2 / overview.px_per_mm
    return replace(overview, grey=grey, seen=seen, low_mm=low, px_per_mm=overview.px_per_mm / factor)


class _Spectrum(NamedTuple):
    """Fourier transforms of the strengths of a picture's edges, with room for the bodies beside it."""

    values: tuple[NDArray[np.complex64], NDArray[np.complex64]]
    """Of edges across x and across y."""
    shape: tuple[int, int]
    """Lines and columns of what was transformed."""

    @staticmethod
    def of(strength: Floats32, room_px: Floats) -> _Spectrum:
        """Transform the strengths (2, h, w) of a picture; the bodies extend over `room_px` (x and y)."""
        (h, w), (x, y) = strength[0].shape, np.ceil(room_px).astype(int).tolist()
        shape = cv2.getOptimalDFTSize(h + y), cv2.getOptimalDFTSize(w + x)
        padded = np.zeros(shape, np.float32)
        values = []
        for one in strength[:2]:
            padded[:h, :w] = one
            values.append(np.fft.rfft2(padded).astype(np.complex64))
        return _Spectrum((values[0], values[1]), shape)


def _best_shift(overview: Overview, picture: _Spectrum, edges: BodyEdges, pose: Pose) -> Pose:
    """Return a pose with the shift at which the edges are strongest, and its score."""
    turn, resolution = pose.matrix[:2, :2], overview.px_per_mm
    points = edges.points @ turn.T * resolution
    weights = (edges.normals @ turn.T) ** 2 * edges.weight[:, None]
    start = np.floor(points.min(0))
    at = np.rint(points - start).astype(np.int_)
    size = at.max(0) + 1
    (h, w), shape = overview.grey.shape, picture.shape
    total = np.zeros((shape[0], shape[1] // 2 + 1), np.complex64)
    for n in range(2):
        template = np.zeros(shape, np.float32)
        np.add.at(template, (at[:, 1], at[:, 0]), weights[:, n].astype(np.float32))
        total += picture.values[n] * np.conj(np.fft.rfft2(template)).astype(np.complex64)
    score = np.fft.irfft2(total, shape)
    # Shifts at which most bodies lie outside of what was filmed are no candidates. Negative ones stand at the end.
    x_shifts, y_shifts = (
        np.arange(-(n // 4), max(most - 3 * n // 4, 0) + 1) for n, most in zip(size, (w, h), strict=True)
    )
    values = score[np.ix_(y_shifts % shape[0], x_shifts % shape[1])]
    y, x = np.unravel_index(int(values.argmax()), values.shape)
    shift = (np.array([x_shifts[x], y_shifts[y]]) - start) / resolution + overview.low_mm
    best = float((values[y, x] - values.mean()) / max(float(values.std()), 1e-9))
    return replace(pose, shift_mm=(float(shift[0]), float(shift[1])), score=best)


def _climbed(overview: Overview, strength: Floats32, edges: BodyEdges, pose: Pose, steps_mm: Sequence[float]) -> Pose:
    """Improve a pose in steps of shift, turn and stretch until no step raises the score."""
    middle, arm = middle_of(edges)
    value = _rated(overview, strength, edges, pose)
    for step in steps_mm:
        for _ in range(_MOST_ROUNDS):
            before = value
            for axis, sign in product(range(4), (1, -1)):
                change = np.zeros(4)
                change[axis] = sign * step
                tried = _changed(pose, change, middle, arm)
                rated = _rated(overview, strength, edges, tried)
                if rated > value:
                    pose, value = tried, rated
            if value == before:
                break
    return pose


def middle_of(edges: BodyEdges) -> tuple[Floats, float]:
    """Return the middle of the bodies and their rms distance from it."""
    middle = edges.points.mean(0)
    return middle, max(float(np.sqrt(((edges.points - middle) ** 2).sum(1).mean())), 1.0)


def _changed(pose: Pose, change: Floats, middle: Floats, arm_mm: float) -> Pose:
    """Return a pose changed by shift x and y, turn and stretch about the middle of the bodies, mm."""
    there = pose.matrix[:2, :2] @ middle + pose.shift_mm + change[:2]
    new = replace(pose, angle_rad=pose.angle_rad + change[2] / arm_mm, scale=pose.scale * (1 + change[3] / arm_mm))
    x, y = there - new.matrix[:2, :2] @ middle
    return replace(new, shift_mm=(float(x), float(y)))


def _difference(edges: BodyEdges, before: Pose, after: Pose) -> Floats:
    """Return the change of a pose as shift x and y, turn and stretch, mm; the inverse of `_changed`."""
    middle, arm = middle_of(edges)
    shift = (after.matrix - before.matrix)[:2] @ (*middle, 1.0)
    return np.array([*shift, (after.angle_rad - before.angle_rad) * arm, (after.scale / before.scale - 1) * arm])


def _rated(overview: Overview, strength: Floats32, edges: BodyEdges, pose: Pose) -> float:
    """Return the sum of the strengths along all edges."""
    return float(np.sum(edge_strengths(overview, strength, edges, pose.matrix) * edges.weight))


def edge_strengths(overview: Overview, strength: Floats32, edges: BodyEdges, matrix: Floats) -> Floats:
    """Return the strength (k,) of the picture's edges at the points of bodies, across their edges."""
    px = (overview.px_from_tester @ matrix)[:2]
    at = (edges.points @ px[:, :2].T + px[:, 2]).astype(np.float32)
    turn = matrix[:2, :2] / np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    across = (edges.normals @ turn.T) ** 2
    # Maps of OpenCV have less than 32767 lines, and a board may have more points: lines of them, the last one filled.
    count, lines = len(at), -(-len(at) // _LINE)
    x, y = (np.resize(at[:, n], (lines, _LINE)) for n in range(2))
    values = [cv2.remap(s, x, y, cv2.INTER_LINEAR, borderValue=0).ravel()[:count] for s in strength]
    return np.asarray(values[0] * across[:, 0] + values[1] * across[:, 1], np.float64)


_BLUR_MM = 0.15
_REACH_MM = 0.3
"""Largest displacement of a component, along each axis, at which it still counts as there."""
_STEPS = (-1.0, -0.5, 0.0, 0.5, 1.0)
_ELSEWHERE = 150
"""Number of other places on the board with which each component is compared."""
_AWAY_MM = 2.0
"""Least distance of these from the component."""


def shares_weaker(overview: Overview, edges: BodyEdges, matrix: Floats) -> Floats:
    """Return for each component (n,) the share of other places of the board at which its body would show weaker edges.

    A component that is there comes near 1; one that is not has any value. Components beyond the picture have NaN.
    `matrix` is that from CAD data in mm to tester coordinates.
    """
    strength = overview.edges(_BLUR_MM)
    px_from_cad = (overview.px_from_tester @ matrix)[:2]
    turn = matrix[:2, :2] / np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    at, across = edges.points @ px_from_cad[:, :2].T + px_from_cad[:, 2], (edges.normals @ turn.T) ** 2
    low, high = at.min(0), at.max(0)
    random = np.random.default_rng(1)
    out = np.full(int(edges.part.max(initial=-1)) + 1, np.nan)
    resolution = overview.px_per_mm
    parts = np.unique(edges.part)
    ends = np.searchsorted(edges.part, parts, side="right").tolist()
    for part, start, end in zip(parts.tolist(), [0, *ends], ends, strict=False):
        of = slice(start, end)
        points, normals = at[of], across[of]
        if not _inside(overview, points):
            continue
        here = _best(strength, points, normals, np.zeros((1, 2)), resolution)[0]
        # Places at which the whole body lies within the extent of all bodies, on the board that is.
        room_low, room_high = low - points.min(0), high - points.max(0)
        shifts = room_low + random.random((_ELSEWHERE, 2)) * (room_high - room_low)
        shifts = shifts[np.hypot(*shifts.T) > _AWAY_MM * resolution]
        elsewhere = _best(strength, points, normals, shifts, resolution)
        out[part] = float((elsewhere < here).mean()) if len(elsewhere) else np.nan
    return out


def _best(strength: Floats32, points: Floats, across: Floats, shifts: Floats, px_per_mm: float) -> Floats:
    """Return the mean strength along a body's edges at its best place near each of k shifts, (k,)."""
    near = np.array(list(product(_STEPS, _STEPS))) * _REACH_MM * px_per_mm
    at = (points + (shifts[:, None] + near).reshape(-1, 1, 2)).astype(np.float32)
    values = [cv2.remap(s, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0) for s in strength]
    mean = (values[0] * across[:, 0] + values[1] * across[:, 1]).mean(1)
    return np.asarray(mean.reshape(len(shifts), len(near)).max(1), np.float64)


def _inside(overview: Overview, points: Floats) -> bool:
    x, y = np.rint(points).astype(int).T
    h, w = overview.seen.shape
    if (x < 0).any() or (y < 0).any() or (x >= w).any() or (y >= h).any():
        return False
    return bool(overview.seen[y, x].all())
