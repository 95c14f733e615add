"""Decide the orientation of a board by the frames of its reference, where fiducials and outline fit both ways.

Patches of the reference are compared with patches of the run at the same CAD coordinates, once for the board as placed
and once for the board turned by 180°. Only patches that differ between the two orientations count.

The reference run of a board type (paper, section 3.3.3), against which later runs of the type are placed.

Frame (i, j) of a run shows nearly the same part of the board as frame (i, j) of the reference. The reference was
stitched, so its points have known CAD coordinates. So each link between the two frames observes a point with known CAD
coordinates, as the detection of a fiducial does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, ReasonCode, Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints, Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.outline import HALF_PATCH_PX, beside_in_cad
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task
from vaoi_station.stitching.matching.frames import Scene

_SCATTER_PX = 0.03
"""Scatter of single links in addition to image noise."""
_OUTLIER = 8.5
"""Residual, in standard deviations, above which a point has no weight: 6 per axis, so 6·√2 in the plane."""
_LEAST_AGREEING = 0.5
"""Least share of the points linked to a reference that must agree on one position of the board."""
_SHARED_PX = 0.006
"""Error that all links of one frame have in common, px. It does not average out."""
_FARTHEST_MM = 0.2
"""Residual, mm, above which a point has no weight in any case: no part lies further from its place."""
_PLACED_MM = 0.04
"""Standard deviation of a part's place on one board against that on another, mm: the links on it have it in common."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A stitched run that serves as the reference of its board type: its result, and the keys of its good frames."""

    stitch: Stitch
    """Result of the reference run, of which CAD mapping, row motion and surface are used."""
    present: frozenset[FrameKey]
    """Good frames of the reference run: (camera, row)."""
    name: str = ""
    """Name by which results refer to this reference."""
    sigma_px: float = 0.0
    """Standard deviation of positions by the reference's CAD mapping, in its worst view, px; an error common to all
    links."""

    def task(self, key: FrameKey) -> Task | None:
        """Return the task that links a frame of a later run to the reference; None if the reference lacks the frame."""
        return Task("reference", key, key) if key in self.present else None


def cad_points(
    links: Sequence[Links], cameras: Sequence[Camera], plane: BoardPlane, reference: Reference
) -> FiducialPoints:
    """Convert links to the reference into observations of points with CAD coordinates.

    The reference run gives the CAD coordinates of each linked point. Points beside the board are left out: a bed, a
    belt or a carrier is not at the same place for every board.
    """
    each = [_points_of(e, cameras[e.task.a[0]], plane, reference) for e in links if len(e.a_px)]
    if not each:
        return FiducialPoints.empty()
    points = FiducialPoints.joined(each)
    # Parts are placed anew on every board. Each of n links on a part carries a share of the error of its place, in all
    # frames together: the mean of them has the variance σ²/n + placed².
    part, sigma_mm = plane.components.find(np.eye(3), plane.cad(points.cad)), points.sigma_mm.copy()
    on, count = part >= 0, np.bincount(part[part >= 0])
    sigma_mm[on] = np.hypot(sigma_mm[on], _PLACED_MM * np.sqrt(count[part[on]]))
    return replace(points, sigma_mm=sigma_mm)


def _points_of(e: Links, camera: Camera, plane: BoardPlane, reference: Reference) -> FiducialPoints:
    """Return the linked points of one frame, without those beside the board."""
    (i, row), key = e.task.a, e.task.b
    assert key is not None
    there = _on_board(e.b_px, camera, reference.stitch, key)
    own = np.flatnonzero(~beside_in_cad(plane.board_type, there, -HALF_PATCH_PX / camera.px_per_mm))
    k, here = len(own), camera.ground(e.a_px[own])
    px = np.sqrt(np.maximum(np.trace(np.linalg.inv(e.information[own]), axis1=1, axis2=2) / 2, 0))
    # The mean of a frame's n links has the variance σ²/n + shared². Each link carries a part of the shared error.
    single = np.hypot(px, _SCATTER_PX) * np.sqrt(1 + k * (_SHARED_PX / _SCATTER_PX) ** 2)
    resolution, which = np.full(k, camera.px_per_mm), np.full(k, REFERENCE)
    row_of, cad = np.full(k, row), plane.flat(there[own])
    return FiducialPoints(
        row_of, here, camera.parallax(here), cad, single / resolution, resolution, which, np.full(k, i)
    )


def _on_board(px: Floats, camera: Camera, stitch: Stitch, key: FrameKey) -> Floats:
    """Return the CAD coordinates (k, 2) of pixels (k, 2) of a frame of the reference.

    Its camera is taken with the N_i that it had in that run: since then it may have moved, or have been calibrated
    again. The reference's board was not exactly in the calibrated plane. Its surface is used to correct the parallax.
    """
    assert stitch.cad_matrix is not None
    ground_mm = camera.ground(px)
    if stitch.camera_matrices is not None:
        ground_mm = apply(np.linalg.inv(np.asarray(stitch.camera_matrices[key[0]])), camera.lens.undistort(px))
    cad_from_row = np.linalg.inv(stitch.cad_matrix) @ np.linalg.inv(stitch.row_motion[key[1]])
    cad = apply(cad_from_row, ground_mm)
    if stitch.surface is None:
        return cad
    lean_mm = camera.parallax(ground_mm) * stitch.surface.height_mm(cad)[:, None]
    return np.asarray(apply(cad_from_row, ground_mm + lean_mm))


def inliers(points: FiducialPoints, residual_px: Floats) -> NDArray[np.bool_]:
    """Return for each of k points with known CAD coordinates whether its residual (k, 2), px, is small enough."""
    limit_mm = _OUTLIER * points.sigma_mm
    # σ of a point of the reference contains the share of an error that many points have in common.
    limit_mm = np.where(points.which == REFERENCE, np.minimum(limit_mm, _FARTHEST_MM), limit_mm)
    return np.asarray(np.hypot(*residual_px.T) <= limit_mm * points.px_per_mm)


def initial_similarity(plane: BoardPlane, reference: Reference, points: FiducialPoints, motion: Motion) -> Floats:
    """Estimate a first C: take C of the reference, and shift it by the median offset of the run's points."""
    c = reference.stitch.cad_matrix
    assert c is not None
    start = np.array([c[0, 0], c[1, 0], c[0, 2], c[1, 2]])
    board = motion.board(points.row, points.ground_mm)
    # The median is used because some links are false and nothing has been adjusted yet.
    off = np.median(board - apply(plane.matrix(start), plane.cad(points.cad)), axis=0)
    return np.concatenate([start[:2], start[2:] + off])


def disagreeing_reference(points: FiducialPoints, residual_px: Floats) -> Failure | None:
    """Return a failure if only the reference places the board and its points do not agree on one position.

    Args:
        residual_px: (k, 2) their residuals in the adjustment.
    """
    if not len(points.which) or (points.which != REFERENCE).any():
        return None
    fitting = int(inliers(points, residual_px).sum())
    if fitting >= _LEAST_AGREEING * len(points.which):
        return None
    # Links of a frame that shows another part of the board agree with one another, but not with those of other frames.
    return Failure(
        f"only {fitting} of {len(points.which)} points of the reference agree on a place of the board (limit "
        f"{_LEAST_AGREEING:.0%}): it is turned, or of another type, or looks unlike the reference",
        ReasonCode.REFERENCE_CONTRADICTS,
    )


_SIDE = 16
"""Number of samples along each side of a patch."""
_PITCH_PX = 4.0
"""Distance between two samples. Frames are read in copies that are reduced by this factor."""
_LEAST_PITCH_MM = 0.15
"""Least distance between two samples: C from the first detections is uncertain by this much."""
_ACROSS = 12
"""Largest number of patches side by side in one frame of the reference."""
_LEAST_CONTRAST = 4.0
"""Least contrast of a patch that is used: standard deviation of its grey levels."""
_DIFFERENT = 0.5
"""A patch shows the orientation only if the run's two patches for it have a correlation below this."""
_LEAST_PATCHES, _ENOUGH_PATCHES = 4, 24
_ALIKE, _APART = 0.5, 0.3
"""Least correlation of the correct orientation, and least difference to the correlation of the other one."""


@dataclass(frozen=True)
class ReferenceOrientation:
    """Median correlation with the reference for both orientations, over the patches that differ between them."""

    as_placed: float
    turned: float
    patches: int

    @property
    def contradicts(self) -> bool:
        """Whether the reference shows that the board is turned by 180°."""
        return self.patches >= _LEAST_PATCHES and _fits(self.turned, self.as_placed)

    @property
    def confirms(self) -> bool:
        """Whether the reference shows that the board lies as placed."""
        return self.patches >= _LEAST_PATCHES and _fits(self.as_placed, self.turned)


def _fits(one: float, other: float) -> bool:
    return one > _ALIKE and one > other + _APART


class ReferenceScene(NamedTuple):
    """The result and the frames of a reference run."""

    stitch: Stitch
    scene: Scene


class Rivals(NamedTuple):
    """The two possible C of a run, (3, 3) from CAD to tester coordinates."""

    placed: Floats
    turned: Floats


def compare_with_reference(
    board_type: BoardType, rivals: Rivals, scene: Scene, motion: Motion, reference: ReferenceScene
) -> ReferenceOrientation:
    """Compare the frames of a run, in both orientations of its board, with those of the reference.

    Args:
        rivals: C as found, and C of the board turned by 180° on the same fiducials.
        reference: the reference, whose orientation is known.
    """
    c = reference.stitch.cad_matrix
    assert c is not None
    run = scene.index(motion.rows_from_tester)
    placed, turned = [], []
    for key in _spread(reference.scene.present):
        cad = _patches(board_type, key, reference)
        if not len(cad):
            continue
        one = Scene(reference.scene.cameras, (key,), reference.scene.prepared)
        theirs = one.index(np.array(reference.stitch.row_motion))
        r, a, b = (
            _read(frames, apply(m, cad)) for frames, m in ((theirs, c), (run, rivals.placed), (run, rivals.turned))
        )
        use = (r.std(1) > _LEAST_CONTRAST) & (_correlation(a, b) < _DIFFERENT)
        placed += _correlation(r[use], a[use]).tolist()
        turned += _correlation(r[use], b[use]).tolist()
        if len(placed) >= _ENOUGH_PATCHES:
            break
    if not placed:
        return ReferenceOrientation(0.0, 0.0, 0)
    return ReferenceOrientation(float(np.median(placed)), float(np.median(turned)), len(placed))


def _spread(keys: tuple[FrameKey, ...]) -> list[FrameKey]:
    """Order frames so that the first ones lie far apart: the middle one, then the middles of both halves, and so on."""
    step, order = len(keys), []
    while step > 1:
        step = -(-step // 2)
        order += list(range(step // 2, len(keys), step))
    return [keys[k] for k in dict.fromkeys([*order, *range(len(keys))])]


def _patches(board_type: BoardType, key: FrameKey, reference: ReferenceScene) -> Floats:
    """Lay k patches of s samples over the part of the board that a reference frame shows: (k, s, 2) CAD coordinates."""
    camera, c = reference.scene.cameras[key[0]], reference.stitch.cad_matrix
    assert c is not None
    pitch = max(_PITCH_PX / camera.px_per_mm, _LEAST_PITCH_MM) / board_type.mm_per_unit
    cad_from_row = np.linalg.inv(reference.stitch.row_motion[key[1]] @ c)
    corners = np.array([(x, y) for x in (0.0, camera.width_px - 1) for y in (0.0, camera.height_px - 1)])
    seen = apply(cad_from_row, camera.ground(corners))
    low, high = board_type.extent()
    low, high = np.maximum(seen.min(0), low), np.minimum(seen.max(0), high)
    size = _SIDE * pitch
    if (high - low < size).any():
        return np.zeros((0, _SIDE**2, 2))
    lines = []
    for axis in (0, 1):
        count = min(int((high[axis] - low[axis]) / size), _ACROSS)
        lines.append(np.linspace(low[axis] + size / 2, high[axis] - size / 2, count))
    centres = np.stack(np.meshgrid(*lines), -1).reshape(-1, 1, 2)
    step = (np.arange(_SIDE) - (_SIDE - 1) / 2) * pitch
    return np.asarray(centres + np.stack(np.meshgrid(step, step), -1).reshape(1, -1, 2))


def _read(frames: FrameIndex, board_mm: Floats) -> Floats:
    """Read the grey levels of k patches of s samples (k, s, 2), board mm; NaN where no frame shows a whole patch."""
    number = frames.nearest(board_mm.mean(1))
    px = frames.project(number, board_mm)

    def samples(image: NDArray[np.uint8], mine: Ints) -> Floats:
        # A pixel of the reduced copy is the mean of 4×4 pixels; the centre of the first lies at 1.5.
        at = ((px[mine] - 1.5) / 4).astype(np.float32)
        small = cv2.resize(image, (image.shape[1] // 4, image.shape[0] // 4), interpolation=cv2.INTER_AREA)
        got = cv2.remap(small.astype(np.float32), at, None, cv2.INTER_LINEAR, borderValue=float("nan"))
        return np.asarray(got, dtype=np.float64)

    return frames.read_samples(number, board_mm.shape[1], samples)


def _correlation(a: Floats, b: Floats) -> Floats:
    """Compute the correlation (k,) of k pairs of patches (k, s); 1 if unknown, so that the pair is not used."""
    a, b = a - a.mean(1, keepdims=True), b - b.mean(1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        out = (a * b).sum(1) / np.sqrt((a**2).sum(1) * (b**2).sum(1))
    return np.where(np.isfinite(out), out, 1.0)
