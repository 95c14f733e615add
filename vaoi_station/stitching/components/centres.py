"""Where the pictures of components are centred, against the places where C puts them.

Fiducials define where the CAD data lie on the board. An error of one fiducial of two, or of three under one camera,
leaves no residual. The components are mounted on pads of the same artwork, and most look alike if they are turned by
180° about their centre: the highest correlation of a patch with itself turned shows the centre, without a model.
Shift, turn and stretch of all together are estimated, with a height (what is seen leans away from the camera's foot)
and an offset of each kind of components, of one size and turned alike (light, shadow and shape displace what looks
symmetric). Single kinds and centres may look off by much more: they lose their weight. An error of one of two
fiducials, which leaves the other in place, is a sharper hypothesis of two numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FootprintViews
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import FiducialPoints, Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

_MOST = 32
"""Largest number of components of which a view is returned."""
_MARGIN_MM = 0.1
"""Width of the rim around a footprint that is compared too. A rim of 0.3 mm contained the silkscreen of neighbours."""
REACH_MM = 0.3
"""Largest distance, along each axis, of a centre of symmetry from its predicted place."""
_MOST_NODES, _MOST_REDUCED = 40, 5
"""Half the side of a compared patch in nodes, at most, and the largest factor by which a frame is reduced for it."""
_LEAST_SCORE, _LEAST_CONTRAST = 0.6, 4.0
"""Least correlation of a patch with itself turned by 180°, and least standard deviation of its grey levels."""
_LEAST = 6
"""Least number of centres from which a shift is estimated."""
_SCATTER_MM, _SCATTER_WEIGHT = 0.017, 3.0
"""Expected scatter of the centres, per axis, mm, and its weight against what the run shows, in centres. Measured:
uncertainty.md."""
_PLACING_MM, _ALIKE_MM = np.array([0.012, 0.012, 0.008, 0.008]), np.array([0.012, 0.012, 0.004, 0.004])
"""Standard deviations of what placement and light change in all components alike: shift, turn and stretch, mm, as in
`ComponentShift.measured`; and those beside the hypothesis of an error of one fiducial."""
_HEIGHT_MM, _HEIGHT_SHARE = (0.0, 1.0), (0.5, 0.5)
"""Mean and standard deviation of the seen height of components, mm, and, if the board type states all heights, as a
share of these: between pads and top."""
_KIND_MM, _KIND_WEIGHT = 0.01, 4.0
"""Expected standard deviation, per axis, of the offset that components of one kind have in common, mm, and its weight
against what the run shows, in offsets. Measured: 0.010 mm (hostile.md)."""
_KNEE, _ROUNDS = 2.0, 12
_LIMIT, _ERROR_LIMIT = 20.0, 10.0
"""Largest χ² of shift, turn and stretch (4 degrees of freedom) that is no contradiction: 1 in 2000 exceeds it; and
largest part of it that an error of one fiducial explains. Measured: correct boards reach 6.1 (hostile.md)."""
_SURELY = 2.0
"""Number of standard deviations beyond the limit at which an error is shown with a probability of 98 %."""
_LIMIT_PX = 0.30
"""Largest error of one of two fiducials that is accepted, px: that of a fiducial's residual where there are more."""


class PartView(NamedTuple):
    """The most central view of a component."""

    part: int
    frame: FrameKey
    px: Floats
    half_px: Floats
    """(2,) half the extent of its footprint along the image's axes."""


def central_views(
    plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion, views: FootprintViews
) -> list[PartView]:
    """Return, frame by frame, one view for each of up to `_MOST` components: that nearest to the frame's centre."""
    if not plane.components.addresses:
        # The views of a board type without components are those of two of its corners.
        return []
    present = np.zeros((len(scene.cameras), len(motion.angle)), np.bool_)
    present[tuple(np.array(scene.present, np.int_).reshape(-1, 2).T)] = True
    use = np.flatnonzero(present[views.camera, views.row])
    centre = np.array([camera.center_px for camera in scene.cameras])
    # Views are ordered by component.
    first = np.flatnonzero(np.diff(views.point[use], prepend=-1))
    ends = np.append(first[1:], len(use))
    chosen = np.unique(np.linspace(0, len(first) - 1, min(len(first), _MOST)).round().astype(np.int_)).tolist()
    every = [use[first[n] : ends[n]] for n in chosen]
    at = np.concatenate([use[:0], *every])
    (x, y), begin = (views.px.take(at, axis=0) - centre[views.camera[at]]).T, np.cumsum([0, *map(len, every)])
    off = np.hypot(x, y)
    best = np.array([at[a + off[a:b].argmin()] for a, b in pairwise(begin.tolist())], np.int_)
    # frame by frame, so that each frame is fetched only once
    best = best[np.lexsort((views.row[best], views.camera[best]))]
    part, camera, row, px = views.point[best], views.camera[best], views.row[best], views.px[best]
    # A footprint's extent in the picture: camera and board may be turned by quarters against one another.
    middles = [np.array([c.center_px, c.center_px]) + ((0, 0), (1, 0)) for c in scene.cameras]
    across = np.array([np.diff(c.row_from_image(px), axis=0)[0] for c, px in zip(scene.cameras, middles, strict=True)])
    way = np.abs(motion.turned(row, across[camera]))
    half_mm = np.ptp(apply(cad_matrix, plane.components.take(part).corners), axis=1) / 2
    half_mm = np.where((way[:, :1] >= way[:, 1:]), half_mm, half_mm[:, ::-1])
    half_px = half_mm * np.array([c.px_per_mm for c in scene.cameras])[camera, None]
    frames = zip(camera.tolist(), row.tolist(), strict=True)
    return [PartView(*view) for view in zip(part.tolist(), frames, px, half_px, strict=True)]


def reduced_patch(
    grey: NDArray[np.uint8], px: Floats, nodes: tuple[int, int], factor: int
) -> NDArray[np.float32] | None:
    """Return the patch of 2·`nodes` + 1 nodes per axis about the pixel nearest to `px`; None if it is not in view."""
    (x, y), (u, v) = map(round, px.tolist()), nodes
    far_x, far_y = factor * u + factor // 2, factor * v + factor // 2
    if min(x - far_x, y - far_y) < 0 or x + far_x >= grey.shape[1] or y + far_y >= grey.shape[0]:
        return None
    patch = grey[y - far_y : y + far_y + 1, x - far_x : x + far_x + 1].astype(np.float32)
    size = 2 * u + 1, 2 * v + 1
    return np.asarray(cv2.resize(patch, size, interpolation=cv2.INTER_AREA) if factor > 1 else patch, np.float32)


def reduction(half_px: Iterable[float], most_nodes: int) -> int:
    """Return the factor by which a patch is reduced to `most_nodes` nodes on each side of its middle, or one more."""
    return 2 * math.ceil((max(half_px) / most_nodes - 1) / 2) + 1


def centre_of_symmetry(
    grey: NDArray[np.uint8], px: Floats, half_px: Floats, px_per_mm: float
) -> tuple[float, float] | None:
    """Return how far (x, y), px, the centre of symmetry of a component lies from its predicted place `px` (2,).

    None if the component is too large, too near to the border, or not symmetric; `half_px` (2,) is half its extent.
    """
    # Plain floats: numpy takes longer for two numbers, and this runs for each component.
    width, height = half = [v + _MARGIN_MM * px_per_mm for v in half_px.tolist()]
    factor = reduction(half, _MOST_NODES)
    if factor > _MOST_REDUCED:
        return None
    # A displacement of the centre by one node displaces the turned patch by two.
    reach = max(math.ceil(2 * REACH_MM * px_per_mm / factor), 2)
    nodes = math.ceil(width / factor) + reach, math.ceil(height / factor) + reach
    patch = reduced_patch(grey, px, nodes, factor)
    if patch is None:
        return None
    turned = np.ascontiguousarray(patch[::-1, ::-1][reach:-reach, reach:-reach])
    if cv2.meanStdDev(turned)[1][0, 0] < _LEAST_CONTRAST:
        return None
    score = cv2.matchTemplate(patch, turned, cv2.TM_CCOEFF_NORMED)
    row, column = divmod(int(score.argmax()), score.shape[1])
    inside = 0 < row < len(score) - 1 and 0 < column < score.shape[1] - 1
    if not inside or score[row, column] < _LEAST_SCORE:
        return None
    x = column - reach + _vertex(*score[row, column - 1 : column + 2].tolist())
    y = row - reach + _vertex(*score[row - 1 : row + 2, column].tolist())
    at_x, at_y = px.tolist()
    return factor * x / 2 + round(at_x) - at_x, factor * y / 2 + round(at_y) - at_y


def _vertex(before: float, top: float, after: float) -> float:
    """Return the place of the maximum of the parabola through three values at −1, 0 and 1."""
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


@dataclass(frozen=True, eq=False)
class ComponentShift:
    """Shift, turn and stretch of the components' centres against the places where C puts them."""

    measured: Floats
    """(4,) mm: shift x and y in tester coordinates, turn and stretch as displacements at the distance `arm_mm`."""
    by_centres: Floats
    """(4, 4) covariance of `measured`, mm², by the scatter of the centres and the offsets of kinds alone."""
    middle_mm: Floats
    arm_mm: float
    """Rms distance of the components from their middle."""
    components: int

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
    """Measure the shift of the components against the places where C puts them; None if too few show their centres."""
    if len(views) < _LEAST:
        return None
    part = np.array([view.part for view in views])
    off_px = np.full((len(views), 2), np.nan)
    for n, (_, key, px, half_px) in enumerate(views):
        off = centre_of_symmetry(scene.prepared(key).grey, px, half_px, scene.cameras[key[0]].px_per_mm)
        if off is not None:
            off_px[n] = off
    found = np.flatnonzero(np.isfinite(off_px[:, 0]))
    if len(found) < _LEAST:
        return None
    camera, row = np.array([view.frame for view in views])[found].T
    px, ends, lean_mm = (
        np.array([view.px for view in views])[found],
        np.empty((2, len(found), 2)),
        np.empty((len(found), 2)),
    )
    for i in np.unique(camera).tolist():
        mine = camera == i
        ends[:, mine] = scene.cameras[i].ground(np.stack([px[mine], px[mine] + off_px[found[mine]]]))
        # a raised point is seen away from its real position, so the offset is the negative of the parallax
        lean_mm[mine] = -scene.cameras[i].parallax(ends[0, mine])
    part, off_mm, lean_mm = part[found], motion.turned(row, ends[1] - ends[0]), motion.turned(row, lean_mm)
    parts, prior = plane.components.take(part), _HEIGHT_MM
    stated = [plane.board_type.components[n].body_height for n in part.tolist()]
    known = np.array([height for height in stated if height is not None])
    if len(known) == len(stated):
        lean_mm, prior = lean_mm * (known * plane.board_type.mm_per_unit)[:, None], _HEIGHT_SHARE
    # Components of one size that are turned alike, or by 180°, are of one kind.
    half_turns = np.rint(np.degrees(parts.angle_rad)).astype(int) % 180
    size_um = np.rint(1e3 * parts.mm_per_unit * parts.size).astype(int)
    kind = np.unique(np.column_stack([size_um, half_turns]), axis=0, return_inverse=True)[1].ravel()
    return _fitted(apply(cad_matrix, plane.components.center)[part], off_mm, lean_mm, kind, prior)


def _equations(board_mm: Floats, middle_mm: Floats, arm_mm: float) -> Floats:
    """Return the displacement (k, 2, 4) of points (k, 2) by one mm of shift x, shift y, turn and stretch."""
    (x, y), out = ((board_mm - middle_mm) / arm_mm).T, np.zeros((len(board_mm), 2, 4))
    out[:, 0, 0] = out[:, 1, 1] = 1.0
    out[:, 0, 2], out[:, 1, 2], out[:, 0, 3], out[:, 1, 3] = -y, x, x, y
    return out


def _fitted(
    board_mm: Floats, off_mm: Floats, lean_mm: Floats, kind: Ints, prior: tuple[float, float]
) -> ComponentShift | None:
    """Estimate the common shift of k components; wrong centres and kinds lose their weight.

    Their centres are seen `off_mm` (k, 2) from their places `board_mm` (k, 2); a height factor of 1 causes `lean_mm`
    (k, 2). `kind` (k,) are numbers from 0 without a gap, `prior` mean and standard deviation of the factor.
    """
    middle, kinds = board_mm.mean(0), np.eye(int(kind.max()) + 1)[kind]
    arm = max(float(np.sqrt(((board_mm - middle) ** 2).sum(1).mean())), 1e-6)
    # unknowns: shift x and y, turn, stretch, height factor, and the offsets of the kinds along x and y
    j = np.concatenate([_equations(board_mm, middle, arm), lean_mm[:, :, None], np.kron(kinds[:, None], np.eye(2))], 2)
    of_kinds, weight, trust = slice(5, None), np.ones(len(board_mm)), np.ones(kinds.shape[1])
    scatter, kind_mm = 3 * _SCATTER_MM, _KIND_MM
    expected, precision = np.zeros(j.shape[2]), np.zeros(j.shape[2])
    expected[4], precision[4] = prior[0], prior[1] ** -2
    covariance, solved = np.eye(j.shape[2]), expected
    for _ in range(_ROUNDS):
        precision[of_kinds] = np.repeat(trust, 2) / kind_mm**2
        weighted = (j * (weight / scatter**2)[:, None, None]).reshape(-1, j.shape[2])
        normal = weighted.T @ j.reshape(-1, j.shape[2])
        low, *_, high = np.linalg.eigvalsh(normal[:4, :4]).tolist()
        if low * 1e8 < high:
            return None
        covariance = np.linalg.inv(normal + np.diag(precision))
        vector = off_mm.ravel() @ weighted
        solved = covariance @ (vector + precision * expected)
        variance = covariance.diagonal()
        # Few centres show their scatter badly, since they determine unknowns too, as far as the priors do not.
        free = len(board_mm) - float((1 - precision * variance).sum()) / 2
        length = np.hypot(*(off_mm - j @ solved).T)
        # 1.1774: median of the length of a normal error in the plane, in standard deviations per axis
        middle_one = np.sort(length)[[(len(length) - 1) // 2, len(length) // 2]].mean()
        seen2 = len(board_mm) * (float(middle_one) / 1.1774) ** 2
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
    return np.asarray((1 + (lengths / _KNEE) ** 2) ** -2.0)


class FiducialError(NamedTuple):
    """An error of one of two fiducials, 0 or 1, that explains where the components are seen."""

    which: int
    mm: float
    chi2: float


def likely_errors(shift: ComponentShift, fiducials_mm: Floats) -> list[FiducialError]:
    """Return the errors of one of two fiducials that the components show, the likeliest first; none if both fit."""
    weight, out = _information(shift), []
    for n, effect in enumerate(_effects(shift, fiducials_mm)):
        information, product = effect.T @ weight @ effect, effect.T @ weight @ shift.measured
        error = np.linalg.solve(information, product)
        out.append(FiducialError(n, float(np.hypot(*error)), float(product @ error)))
    return sorted((e for e in out if e.chi2 > _ERROR_LIMIT), key=lambda e: -e.chi2)


def unnoticed_mm(shift: ComponentShift, fiducials_mm: Floats) -> float:
    """Return the error of one of two fiducials (2, 2), tester coordinates, mm, that the components surely show."""
    weight = _information(shift)
    weakest = min(float(np.linalg.eigvalsh(e.T @ weight @ e)[0]) for e in _effects(shift, fiducials_mm))
    return (math.sqrt(_ERROR_LIMIT) + _SURELY) / math.sqrt(max(weakest, 1e-12))


def _information(shift: ComponentShift) -> Floats:
    """Return the inverse (4, 4) of the covariance of what the components show, 1/mm²."""
    return np.asarray(np.linalg.inv(shift.by_centres + np.diag(_ALIKE_MM**2)))


def _effects(shift: ComponentShift, fiducials_mm: Floats) -> list[Floats]:
    """Return for each of two fiducials the change (4, 2) of what the components show by 1 mm of error along x and y."""
    place, middle = fiducials_mm @ (1, 1j), complex(*shift.middle_mm)
    out = []
    for own, other in (place, place[::-1]):
        slope = np.array([1, 1j]) / (own - other)
        moved, arm = slope * (middle - other), slope * shift.arm_mm
        out.append(np.stack([moved.real, moved.imag, arm.imag, arm.real]))
    return out


def component_reasons(
    shift: ComponentShift | None, plane: BoardPlane, cad_matrix: Floats, points: FiducialPoints, px_per_mm: float
) -> list[Reason]:
    """Return a reason if the pictures of the components are centred elsewhere than C puts them."""
    if shift is None:
        return []
    places = apply(cad_matrix, plane.cad(plane.fiducials))
    names = [fiducial.name for fiducial in plane.board_type.fiducials]
    if shift.contradicts:
        off_mm = np.hypot(*shift.at(places).T) if len(places) else np.zeros(0)
        where = ""
        if len(off_mm):
            n = int(off_mm.argmax())
            where = f", which is {off_mm[n]:.2f} mm ({off_mm[n] * px_per_mm:.1f} px) at fiducial {names[n]}"
        (x, y), (sx, sy) = shift.measured[:2], np.sqrt(np.diag(shift.covariance))[:2]
        text = (
            f"the pictures of {shift.components} components are centred ({x:+.3f}, {y:+.3f}) mm ± ({sx:.3f}, "
            f"{sy:.3f}) from where fiducials and CAD data put them, and turned or stretched{where}: a fiducial is not "
            "at its CAD position, or the centres of the components in the CAD data are not those of the parts"
        )
        return [Reason(ReasonCode.COMPONENTS_SHIFTED, text)]
    used = plane.placing(points)
    errors = likely_errors(shift, places[used]) if len(used) == 2 and (points.which >= 0).all() else []
    if not errors or errors[0].mm * px_per_mm <= _LIMIT_PX:
        return []
    each = ", or ".join(f"{names[used[e.which]]} by {e.mm:.2f} mm ({e.mm * px_per_mm:.1f} px)" for e in errors)
    text = (
        f"the pictures of {shift.components} components are centred as if one of the two fiducials were not at its CAD "
        f"position: {each}; check both in the CAD data and on the board; a third fiducial off the line of the two, or "
        "a taught reference, shows which of them is right"
    )
    return [Reason(ReasonCode.COMPONENTS_SHIFTED, text)]
