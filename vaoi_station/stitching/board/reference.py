"""The reference run of a board type (paper, section 3.3.3), against which later runs of the type are placed.

Frame (i, j) of a run shows nearly the same part of the board as frame (i, j) of the reference. A link between the two
observes a point with known CAD coordinates, as the detection of a fiducial does. Where fiducials and outline fit both
ways, patches of the reference decide the orientation: they are compared with patches of the run at the same CAD
coordinates, as placed and turned by 180°.
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
from vaoi_station.stitching.board.outline import HALF_PATCH_PX, depths_mm
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task
from vaoi_station.stitching.matching.frames import Scene

_SCATTER_PX, _SHARED_PX = 0.03, 0.006
"""Scatter of single links in addition to image noise; error that all links of one frame have in common, px."""
_OUTLIER, _FARTHEST_MM = 8.5, 0.2
"""Residual, in standard deviations (6 per axis, so 6·√2 in the plane), above which a point has no weight; for points of
a reference also in mm: no part lies further from its place."""
_PLACED_MM = 0.04
"""Standard deviation of a part's place on one board against that on another, mm: the links on it have it in common."""
_LEAST_AGREEING = 0.5
"""Least share of the points linked to a reference that must agree on one position of the board."""
_SIDE = 16
"""Number of samples along each side of a patch."""
_PITCH_PX, _LEAST_PITCH_MM = 4.0, 0.15
"""Distance between two samples in frames that are reduced by this factor; C from the first detections is uncertain by
the second."""
_ACROSS = 12
"""Largest number of patches side by side in one frame of the reference."""
_LEAST_CONTRAST, _DIFFERENT = 4.0, 0.5
"""Least standard deviation of the grey levels of a patch, and correlation of the run's two patches for it, from which
on it does not show the orientation."""
_LEAST_PATCHES, _ENOUGH_PATCHES = 4, 24
_ALIKE, _APART = 0.5, 0.3
"""Least correlation of the correct orientation, and least difference to the correlation of the other one."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A stitched run that serves as the reference of its board type: its result, and the keys of its good frames."""

    stitch: Stitch
    present: frozenset[FrameKey]
    name: str = ""
    sigma_px: float = 0.0
    """Standard deviation of positions by its CAD mapping, in its worst view, px; an error common to all links."""

    def task(self, key: FrameKey) -> Task | None:
        """Return the task that links a frame of a later run to the reference; None if the reference lacks the frame."""
        return Task("reference", key, key) if key in self.present else None


def cad_points(
    links: Sequence[Links], cameras: Sequence[Camera], plane: BoardPlane, reference: Reference
) -> FiducialPoints:
    """Convert links to the reference, without those beside the board, into observations of points with CAD data."""
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
    own = np.flatnonzero(depths_mm(plane.board_type, there) >= HALF_PATCH_PX / camera.px_per_mm)
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
    """Return the CAD coordinates (k, 2) of pixels (k, 2) of a frame of the reference, with the N_i that it had then."""
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
    """Return a failure if only the reference places the board and its points do not agree on one position."""
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


def compare_with_reference(
    board_type: BoardType, as_placed: Floats, turned: Floats, scene: Scene, motion: Motion, reference: ReferenceScene
) -> ReferenceOrientation:
    """Compare the frames of a run, in both orientations of its board, with those of the reference."""
    c = reference.stitch.cad_matrix
    assert c is not None
    run, own, other = scene.index(motion.rows_from_tester), list[float](), list[float]()
    for key in _spread(reference.scene.present):
        cad = _patches(board_type, key, reference)
        if not len(cad):
            continue
        one = Scene(reference.scene.cameras, (key,), reference.scene.prepared)
        theirs = _read(one.index(np.array(reference.stitch.row_motion)), apply(c, cad))
        a, b = _read(run, apply(as_placed, cad)), _read(run, apply(turned, cad))
        use = (theirs.std(1) > _LEAST_CONTRAST) & (_correlation(a, b) < _DIFFERENT)
        own += _correlation(theirs[use], a[use]).tolist()
        other += _correlation(theirs[use], b[use]).tolist()
        if len(own) >= _ENOUGH_PATCHES:
            break
    if not own:
        return ReferenceOrientation(0.0, 0.0, 0)
    return ReferenceOrientation(float(np.median(own)), float(np.median(other)), len(own))


def _spread(keys: tuple[FrameKey, ...]) -> list[FrameKey]:
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
    count = np.minimum((high - low) / size, _ACROSS).astype(int)
    lines = [np.linspace(a, b, n) for a, b, n in zip(low + size / 2, high - size / 2, count, strict=True)]
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
