"""Decide the orientation of a board by the frames of its reference, where fiducials and outline fit both ways.

Patches of the reference are compared with patches of the run at the same CAD coordinates, once for the board as placed
and once for the board turned by 180°. Only patches that differ between the two orientations count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.frame_visibility import FrameArrays
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.scene import Scene

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
        board_type: board type, whose extent is used.
        rivals: C as found, and C of the board turned by 180° on the same fiducials.
        scene: the cameras and frames of the run.
        motion: motion of the run's rows.
        reference: the reference, whose orientation is known.
    """
    c = reference.stitch.cad_matrix
    assert c is not None
    run = FrameArrays.of(scene, motion)
    placed, turned = [], []
    for key in _spread(reference.scene.present):
        cad = _patches(board_type, key, reference)
        if not len(cad):
            continue
        one = Scene(reference.scene.cameras, (key,), reference.scene.prepared)
        theirs = FrameArrays.of_rows(one, np.array(reference.stitch.row_motion))
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


def _read(frames: FrameArrays, board_mm: Floats) -> Floats:
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
