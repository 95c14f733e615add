"""The shift of all components together against the places where C puts their centres.

Fiducials define where the CAD data lie on the board. An error of one fiducial of two, or of three under one camera,
leaves no residual: height and scale of the board explain it. The components are mounted on pads of the same artwork.
The centres of some of them are measured in the frames, and shift, turn and stretch of all together are estimated.

What is seen of a component follows its pads on the board and its top, which leans away from the camera's foot. Under
one camera this looks like a stretch of the board. The height that explains the lean is therefore a fifth unknown.

Components of one kind, of the same size and turned alike, are seen off their places alike: light, shadow and shape of a
package displace what looks symmetric. Each kind has an offset of its own, whose size the run shows, so that the
accuracy of the shift follows from the number of kinds, not only from that of components. Single kinds may look off by
much more than the others: like single centres, they then lose their weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.part_views import PartView
from vaoi_station.stitching.components.symmetry import centre_of_symmetry
from vaoi_station.stitching.matching.scene import Scene

_LEAST = 6
"""Least number of centres from which a shift is estimated."""
_SCATTER_MM, _SCATTER_WEIGHT = 0.017, 3.0
"""Expected scatter of the centres, per axis, mm, and its weight against what the run shows, in centres. Measured:
0.017 mm (uncertainty.md)."""
_PLACING_MM = np.array([0.012, 0.012, 0.008, 0.008])
"""Standard deviations of what placement and light change in all components alike: shift, turn and stretch, mm.

Turn and stretch are the displacement that they cause at the rms distance of the components from their middle."""
_HEIGHT_MM = (0.0, 1.0)
"""Mean and standard deviation of the seen height of components, if the board type does not state all heights, mm."""
_HEIGHT_SHARE = (0.5, 0.5)
"""Mean and standard deviation of the seen height as a share of the stated heights: between pads and top."""
_KIND_MM, _KIND_WEIGHT = 0.01, 4.0
"""Expected standard deviation, per axis, of the offset that components of one kind have in common, mm, and its weight
against what the run shows, in offsets. Measured: 0.010 mm (hostile.md)."""
_KNEE, _ROUNDS = 2.0, 12
_LIMIT = 20.0
"""Largest χ² of shift, turn and stretch (4 degrees of freedom) that is no contradiction: 1 in 2000 exceeds it."""


@dataclass(frozen=True, eq=False)
class ComponentShift:
    """Shift, turn and stretch of the components' centres against the places where C puts them."""

    measured: Floats
    """(4,) mm: shift x and y in tester coordinates, turn and stretch as displacements at the distance `arm_mm`."""
    by_centres: Floats
    """(4, 4) covariance of `measured`, mm², by the scatter of the centres and the offsets of kinds alone."""
    middle_mm: Floats
    """(2,) mean of the components' places in tester coordinates."""
    arm_mm: float
    """Rms distance of the components from their middle."""
    components: int
    """Number of components that were measured."""

    @property
    def covariance(self) -> Floats:
        """(4, 4) covariance of `measured`, mm², with what placement and light change in all components alike."""
        return self.by_centres + np.diag(_PLACING_MM**2)

    @property
    def contradicts(self) -> bool:
        """Whether the components lie elsewhere than C puts them, by more than noise and placement explain."""
        return float(self.measured @ np.linalg.solve(self.covariance, self.measured)) > _LIMIT

    def at(self, board_mm: Floats) -> Floats:
        """Return the displacement (k, 2) of points (k, 2) in tester coordinates, mm."""
        return np.asarray(_equations(board_mm, self.middle_mm, self.arm_mm) @ self.measured)


def measure_component_shift(
    plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion, views: Sequence[PartView]
) -> ComponentShift | None:
    """Measure the shift of the components against the places where C puts them.

    Args:
        plane: plane of the board type.
        cad_matrix: C, (3, 3) from CAD to tester coordinates.
        scene: the cameras and frames.
        motion: motion of the rows.
        views: one view of each component.

    Returns:
        The shift; None if the centres of too few components can be measured.
    """
    if len(views) < _LEAST:
        return None
    part = np.array([view.part for view in views])
    off_mm, lean_mm = np.full((len(views), 2), np.nan), np.zeros((len(views), 2))
    for n, (_, (i, j), px, half_px) in enumerate(views):
        camera, grey = scene.cameras[i], scene.prepared((i, j)).grey
        off = centre_of_symmetry(grey, px, half_px, camera.px_per_mm)
        if off is not None:
            ends = camera.ground(np.array([px, px + off]))
            off_mm[n] = motion.turned(np.array([j]), np.diff(ends, axis=0))[0]
            # a raised point is seen away from its real position, so the offset is the negative of the parallax
            lean_mm[n] = -motion.turned(np.array([j]), camera.parallax(ends[:1]))[0]
    found = np.isfinite(off_mm).all(1)
    if found.sum() < _LEAST:
        return None
    part, off_mm = part[found], off_mm[found]
    heights, prior = _heights(plane, part)
    seen = _Seen(
        apply(cad_matrix, plane.components.center)[part],
        off_mm,
        lean_mm[found] * heights[:, None],
        _kinds(plane, part),
    )
    return _fitted(seen, prior)


class _Seen(NamedTuple):
    """Centres of k components as they are seen."""

    board_mm: Floats
    """(k, 2) places of the components, tester coordinates."""
    off_mm: Floats
    """(k, 2) offsets of their centres from these places."""
    lean_mm: Floats
    """(k, 2) offsets that a height factor of 1 causes."""
    kind: Ints
    """(k,) numbers of their kinds, from 0 on without a gap."""


def _kinds(plane: BoardPlane, part: Ints) -> Ints:
    """Return the kinds (k,) of components: those of one size that are turned alike, or by 180°, are of one kind."""
    parts = plane.components.take(part)
    half_turns = np.rint(np.degrees(parts.angle_rad)).astype(int) % 180
    size_um = np.rint(1e3 * parts.mm_per_unit * parts.size).astype(int)
    return np.asarray(np.unique(np.column_stack([size_um, half_turns]), axis=0, return_inverse=True)[1]).ravel()


def _heights(plane: BoardPlane, part: np.ndarray) -> tuple[Floats, tuple[float, float]]:
    """Return the heights (k,) of components and the prior (mean, standard deviation) of their common factor.

    The heights are 1 mm, and the factor is the height in mm, unless the board type states the height of all k.
    """
    stated = [plane.board_type.components[n].body_height for n in part.tolist()]
    known = [height * plane.board_type.mm_per_unit for height in stated if height is not None]
    if len(known) < len(stated):
        return np.ones(len(stated)), _HEIGHT_MM
    return np.array(known), _HEIGHT_SHARE


def _equations(board_mm: Floats, middle_mm: Floats, arm_mm: float) -> Floats:
    """Return the displacement (k, 2, 4) of points (k, 2) by one mm of shift x, shift y, turn and stretch."""
    (x, y), out = ((board_mm - middle_mm) / arm_mm).T, np.zeros((len(board_mm), 2, 4))
    out[:, 0, 0] = out[:, 1, 1] = 1.0
    out[:, 0, 2], out[:, 1, 2], out[:, 0, 3], out[:, 1, 3] = -y, x, x, y
    return out


def _fitted(seen: _Seen, prior: tuple[float, float]) -> ComponentShift | None:
    """Estimate the common shift of k components; wrong centres and kinds lose their weight.

    Args:
        seen: the components' centres.
        prior: mean and standard deviation of the height factor.
    """
    board_mm, off_mm = seen.board_mm, seen.off_mm
    middle, kinds = board_mm.mean(0), np.eye(int(seen.kind.max()) + 1)[seen.kind]
    arm = max(float(np.sqrt(((board_mm - middle) ** 2).sum(1).mean())), 1e-6)
    # unknowns: shift x and y, turn, stretch, height factor, and the offsets of the kinds along x and y
    j = np.concatenate(
        [_equations(board_mm, middle, arm), seen.lean_mm[:, :, None], np.kron(kinds[:, None], np.eye(2))], 2
    )
    of_kinds, weight, trust = slice(5, None), np.ones(len(board_mm)), np.ones(kinds.shape[1])
    scatter, kind_mm = 3 * _SCATTER_MM, _KIND_MM
    expected, precision = np.zeros(j.shape[2]), np.zeros(j.shape[2])
    expected[4], precision[4] = prior[0], prior[1] ** -2
    covariance, solved = np.eye(j.shape[2]), expected
    for _ in range(_ROUNDS):
        precision[of_kinds] = np.repeat(trust, 2) / kind_mm**2
        normal = np.einsum("k,kia,kib->ab", weight, j, j) / scatter**2
        if np.linalg.cond(normal[:4, :4]) > 1e8:
            return None
        covariance = np.linalg.inv(normal + np.diag(precision))
        vector = np.einsum("k,kia,ki->a", weight, j, off_mm) / scatter**2
        solved = covariance @ (vector + precision * expected)
        variance = covariance.diagonal()
        # Few centres show their scatter badly, since they determine unknowns too, as far as the priors do not.
        free = len(board_mm) - float((1 - precision * variance).sum()) / 2
        length = np.hypot(*(off_mm - j @ solved).T)
        # 1.1774: median of the length of a normal error in the plane, in standard deviations per axis
        seen2 = len(board_mm) * (float(np.median(length)) / 1.1774) ** 2
        scatter = math.sqrt((seen2 + _SCATTER_WEIGHT * _SCATTER_MM**2) / (max(free, 0.0) + _SCATTER_WEIGHT))
        weight = _weights(length / scatter)
        # What the offsets of the kinds are, and what is not known of them, shows how large such offsets are.
        offsets, unsure = (v[of_kinds].reshape(-1, 2) for v in (solved, variance))
        shown = float(trust @ (offsets**2 + unsure).sum(1))
        kind_mm = math.sqrt((shown + _KIND_WEIGHT * _KIND_MM**2) / (2 * trust.sum() + _KIND_WEIGHT))
        trust = _weights(np.hypot(*offsets.T) / kind_mm)
    if weight.sum() < _LEAST / 2:
        return None
    return ComponentShift(solved[:4], covariance[:4, :4], middle, arm, len(board_mm))


def _weights(lengths: Floats) -> Floats:
    """Return the robust weights (k,) of errors of these lengths (k,), in standard deviations per axis."""
    return np.asarray((1 + (lengths / _KNEE) ** 2) ** -2.0)
