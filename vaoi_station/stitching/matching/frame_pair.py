"""Two frames to be linked, and where they show the same part of the board, by the cameras and the belt's motion.

A match between two frames only shifts a patch; it does not scale or rotate it. This is enough for the small differences
in scale and rotation of an ordinary array. If the camera matrices differ by more, part of the finer frame is resampled:
the linear map that the camera matrices predict gives it the resolution and the direction of the coarser frame. Links
are found in this grid and returned in pixels of the frames.

Where a frame is saturated, a darker frame of the same place still shows texture; where the darker one has hardly any
light, noise hides what the brighter one shows. Patches of the two would then match badly, or in the wrong place. The
darker frame is brought to the grey levels of the brighter one, both are limited to the same level, and if the
exposures differ much, both are smoothed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import transfer_points
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.frames import PreparedFrame, resample
from vaoi_station.stitching.matching.patches import are_inside_both, patch_centres
from vaoi_station.stitching.matching.refinement import MARGIN_PX, WINDOW_PX

Box = tuple[int, int, int, int]  # a rectangle (x0, y0, x1, y1) in pixels; column x1 and line y1 do not belong to it
_UPRIGHT = math.cos(math.radians(2.0))  # frames are turned against one another if the cosine of their angle is below
_LEAST_PX = 2.0  # least width of an overlap, px. A narrower one is only the result of rounding
_WARPED_PX = 0.25
"""Frames are resampled if scale or rotation displaces the border of a patch by more than this.

With a shift alone, matches would then be wrong by some hundredths of a pixel."""
_GRAIN_PX = 16  # a resampled part begins at a multiple of this, so that reduced copies have about the same pixels
_BESIDE_PX = 2 * MARGIN_PX  # distance by which a resampled part extends beyond the overlap
_DENSEST = 4.0  # largest factor on the density of corners where the overlap fills only part of its box
_KEPT_MAPS = 256  # entries of the cache of linear maps, one for each pair of cameras
_BLOCK_PX = 8  # side of the blocks whose means are compared
_HIGH, _LEAST_BLOCKS = 220, 50
"""Largest grey level of the blocks of the brighter frame, and their least number, from which the ratio is estimated."""
_CEILING = 240
"""Grey level to which both frames are limited: below saturation, since they are then equally flat where one of them is
saturated."""
_EQUAL, _NOISY = 0.6, 0.25
"""Ratio of the grey levels down to which frames are compared as they are, and below which they are smoothed."""
_ALIKE = 0.7  # least correlation of the block means of two frames that show the same
_SMOOTH_PX = 1.5  # standard deviation of the smoothing: it leaves a thirtieth of the variance of white noise
_IDENTITY = np.eye(2, 3)


def predict(a_px: Floats, a: Camera, b: Camera, shift_mm: Floats) -> Floats:
    """Predict where frame b shows the points (k, 2) of frame a, both in raw pixels.

    The points lie in the calibrated plane, and the board moves by `shift_mm` (2,) from frame a to frame b.
    """
    return transfer_points(a_px, a.arrays, b.arrays, np.asarray(shift_mm, dtype=np.float64))


def overlap_box(a: Camera, b: Camera, shift_mm: Floats) -> Box | None:
    """Return the part of frame a that frame b shows too, or None if the frames do not overlap.

    It is exact if the two frames differ by a shift, and accurate to a pixel or two at the small rotations of a camera
    array. For larger rotations, it is the smallest rectangle around the part that both frames show.
    """
    # A belt of even speed repeats the same shift in every row.
    return _overlap_box(a, b, float(shift_mm[0]), float(shift_mm[1]))


@lru_cache(maxsize=_KEPT_MAPS)
def _overlap_box(a: Camera, b: Camera, x_mm: float, y_mm: float) -> Box | None:
    shift_mm = np.array([x_mm, y_mm])
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = _border_in(a, b, shift_mm).tolist()
    if bx - ax < _UPRIGHT * math.hypot(bx - ax, by - ay):
        return _box_around(overlap_polygon(a, b, shift_mm))
    x0, y0, x1, y1 = max(ax, dx, 0.0), max(ay, by, 0.0), min(bx, cx, a.width_px - 1.0), min(cy, dy, a.height_px - 1.0)
    if x1 - x0 < _LEAST_PX or y1 - y0 < _LEAST_PX:
        return None
    return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1


def overlap_polygon(a: Camera, b: Camera, shift_mm: Floats, margins_px: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return the corners (k, 2) of the part of frame a that frame b shows too; none (0, 2) if there is no overlap.

    `margins_px` are the widths of the strips along the borders of frames a and b that are left out.
    """
    sides = [min(c.width_px, c.height_px) - 1 - 2 * margin for c, margin in zip((a, b), margins_px, strict=True)]
    back = _border_in(a, b, shift_mm, margins_px[1])
    if min(sides) < _LEAST_PX or not np.isfinite(back).all():
        return np.zeros((0, 2))
    area, common = cv2.intersectConvexConvex(_border(a, margins_px[0]).astype(np.float32), back.astype(np.float32))
    if common is None or area < _LEAST_PX**2 or np.ptp(common[:, 0], axis=0).min() < _LEAST_PX:
        return np.zeros((0, 2))
    return np.asarray(common[:, 0], dtype=np.float64)


def _box_around(polygon: Floats) -> Box | None:
    if len(polygon) < 3:
        return None
    (x0, y0), (x1, y1) = polygon.min(0).tolist(), polygon.max(0).tolist()
    return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1


def _border(camera: Camera, margin_px: float = 0.0) -> Floats:
    """Return the corners (4, 2) of a frame without a strip along its border."""
    low, w, h = margin_px, camera.width_px - 1.0 - margin_px, camera.height_px - 1.0 - margin_px
    return np.array([(low, low), (w, low), (w, h), (low, h)])


def _border_in(a: Camera, b: Camera, shift_mm: Floats, margin_px: float = 0.0) -> Floats:
    """Project the border of frame b into frame a."""
    return predict(_border(b, margin_px), b, a, -np.asarray(shift_mm))


def overlap_share(camera: Camera, shift_mm: Floats) -> float:
    """Return the share (0 to 1) of a camera's frame still in view after the board has moved by `shift_mm` (2,)."""
    box = overlap_box(camera, camera, shift_mm)
    if box is None:
        return 0.0
    return (box[2] - box[0]) * (box[3] - box[1]) / (camera.width_px * camera.height_px)


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames to be linked, their cameras, and the predicted shift of the board between the frames.

    `a` and `b` may be in one grid of pixels, that of the coarser frame, of the other of which a part is resampled.
    Positions in them are pixels of the grid, counted from the first pixel of the whole frame or of the part.
    """

    a: PreparedFrame
    b: PreparedFrame
    camera_a: Camera
    camera_b: Camera
    shift_mm: Floats  # (2,) nominal motion of the board from frame a to frame b
    whole: FramePair | None = None  # the frames without a grid
    a_from_grid: Floats = field(default_factory=lambda: _IDENTITY)  # (2, 3) affine map from pixels of `a` to raw pixels
    b_from_grid: Floats = field(default_factory=lambda: _IDENTITY)

    @property
    def px_per_mm(self) -> float:
        """Resolution of the grid in which the links are found."""
        return self.camera_a.px_per_mm / _scale(self.a_from_grid)

    @cached_property
    def _common(self) -> Floats:
        """Corners (k, 2) of the part of `a` that both frames show."""
        polygon = overlap_polygon(self.camera_a, self.camera_b, self.shift_mm)
        return _moved(_inverse(self.a_from_grid), polygon)

    @cached_property
    def _places(self) -> Floats:
        """Corners (k, 2) of the part of `a` in which a patch lies inside both frames."""
        margins = (MARGIN_PX + 1) * _scale(self.a_from_grid), (MARGIN_PX + 1) * _scale(self.b_from_grid)
        polygon = overlap_polygon(self.camera_a, self.camera_b, self.shift_mm, margins)
        return _moved(_inverse(self.a_from_grid), polygon)

    @property
    def room(self) -> bool:
        """Whether the overlap may be large enough for a patch."""
        return self.whole is None or len(self._places) >= 3

    @property
    def spread(self) -> float:
        """Area of the box around the overlap, divided by the area in which a patch can be matched."""
        if self.whole is None or not self.room:
            return 1.0
        size = np.maximum(np.ptp(self._common, axis=0) - 2 * MARGIN_PX, 1.0)
        area = abs(float(cv2.contourArea(self._places.astype(np.float32))))
        return float(np.clip(size.prod() / max(area, 1.0), 1.0, _DENSEST))

    def overlap(self) -> Box | None:
        """Return the part of frame a that frame b is predicted to show too; None if the frames do not overlap."""
        if self.whole is None:
            return overlap_box(self.camera_a, self.camera_b, self.shift_mm)
        return _box_around(self._common)

    def predict(self, a_px: Floats) -> Floats:
        """Predict where frame b shows the points (k, 2) of frame a."""
        if self.whole is None:
            return predict(a_px, self.camera_a, self.camera_b, self.shift_mm)
        return _moved(_inverse(self.b_from_grid), self.whole.predict(_moved(self.a_from_grid, a_px)))

    def offset_px(self, box: Box) -> Floats:
        """Return the predicted position in frame b minus the position in frame a (2,), in the middle of an overlap."""
        x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
        if self.whole is None:
            shift = float(self.shift_mm[0]), float(self.shift_mm[1])
            return np.array(_offset_px(self.camera_a, self.camera_b, *shift, x, y))
        return np.asarray(self.predict(np.array([[x, y]]))[0] - (x, y))

    def inside(self, corners: NDArray[np.int64], guess_px: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Return those corners (k, 2) in a, and their guesses (k, 2) in b, whose patches lie inside both frames."""
        keep = are_inside_both(self.a.grey.shape, self.b.grey.shape, corners, guess_px)
        if self.whole is not None:
            keep &= _holds(self.camera_a, self.a_from_grid, patch_centres(corners))
            keep &= _holds(self.camera_b, self.b_from_grid, guess_px)
        return (corners, guess_px) if keep.all() else (corners[keep], guess_px[keep])

    def reaching(self, reach_px: float) -> FramePair:
        """Return the pair with a resampled part large enough for a search within ± `reach_px`."""
        return self if self.whole is None else in_one_grid(self.whole, reach_px)

    def in_frames(self, links: Links) -> Links:
        """Return links that were found in the grid of this pair, in raw pixels of the frames."""
        if self.whole is None or not len(links.a_px):
            return links
        # A patch may have been found among the repeated border pixels beside a resampled frame.
        keep = _holds(self.camera_b, self.b_from_grid, links.b_px)
        if not keep.any():
            return Links.empty(links.task, "the places found lie beside the frame", links.tried)
        linear = self.b_from_grid[:, :2]
        back = np.linalg.inv(linear)
        return replace(
            links,
            a_px=_moved(self.a_from_grid, links.a_px[keep]),
            b_px=_moved(self.b_from_grid, links.b_px[keep]),
            information=np.ascontiguousarray(back.T @ links.information[keep] @ back),
            score=links.score[keep],
            coarse_px=None if links.coarse_px is None else tuple((linear @ links.coarse_px).tolist()),
        )


@lru_cache(maxsize=_KEPT_MAPS)
def _offset_px(a: Camera, b: Camera, x_mm: float, y_mm: float, x: float, y: float) -> tuple[float, float]:
    """Return by how much a point (x, y) of frame a is predicted to move to frame b."""
    ((u, v),) = predict(np.array([[x, y]]), a, b, np.array([x_mm, y_mm])).tolist()
    return u - x, v - y


def in_one_grid(pair: FramePair, reach_px: float = 0.0) -> FramePair:
    """Return two whole frames in one grid of pixels; the pair itself if they differ by little more than a shift.

    `reach_px` is the range of a search around the prediction.
    """
    if pair.camera_a is pair.camera_b or not is_warped(pair.camera_a, pair.camera_b):
        return pair
    polygon = overlap_polygon(pair.camera_a, pair.camera_b, pair.shift_mm)
    if len(polygon) < 3:
        return pair
    middle = (polygon.min(0) + polygon.max(0)) / 2
    there, *steps = pair.predict(middle + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
    linear = (np.array(steps) - there).T
    b_from_a = np.column_stack([linear, there - linear @ middle])
    if _scale(b_from_a) >= 1 - 1e-3:
        part, origin = _resampled(pair.b, b_from_a, polygon, reach_px, pair.a.factor)
        b_from_grid = _shifted(b_from_a, origin)
        shown = _moved(_inverse(b_from_grid), _border(pair.camera_b))
        return replace(pair, a=pair.a.masked(polygon), b=part.masked(shown), whole=pair, b_from_grid=b_from_grid)
    in_b, a_from_b = _moved(b_from_a, polygon), _inverse(b_from_a)
    part, origin = _resampled(pair.a, a_from_b, in_b, 0.0, pair.b.factor)
    return replace(pair, a=part.masked(in_b - origin), whole=pair, a_from_grid=_shifted(a_from_b, origin))


@lru_cache(maxsize=_KEPT_MAPS)
def is_warped(a: Camera, b: Camera) -> bool:
    """Whether the frames of two cameras differ so much in scale or rotation that shifted patches do not match."""
    # Reduced copies of frames of different size do not have the same pixels, unless one frame is resampled.
    if (a.width_px, a.height_px) != (b.width_px, b.height_px):
        return True
    b_from_a = _linear(b) @ np.linalg.inv(_linear(a))
    return bool(np.linalg.norm(b_from_a - np.eye(2), 2) * WINDOW_PX / 2 > _WARPED_PX)


def _linear(camera: Camera) -> Floats:
    """Return the derivative (2, 2) of undistorted pixels by mm in the middle of a camera's view."""
    middle = camera.row_from_image(camera.center_px)
    return np.asarray((camera.image_from_row(middle + np.eye(2)) - camera.center_px).T)


def _resampled(
    frame: PreparedFrame, frame_from_grid: Floats, polygon: Floats, reach_px: float, factor: int
) -> tuple[PreparedFrame, Floats]:
    """Resample the part of a frame around a polygon, and return it with the grid position (2,) of its first pixel.

    Args:
        frame_from_grid: (2, 3) affine map from the grid to pixels of the frame.
        polygon: (k, 2) corners in the grid.
        reach_px: by how much a search may exceed the polygon.
        factor: reduction of the copies in which the other frame is searched.
    """
    beside = _BESIDE_PX + reach_px
    low = np.floor((polygon.min(0) - beside) / _GRAIN_PX) * _GRAIN_PX
    size = np.ceil((polygon.max(0) + beside - low) / _GRAIN_PX) * _GRAIN_PX
    wide = max(_scale(frame_from_grid), 1.0)
    part = PreparedFrame(resample(frame.grey, _shifted(frame_from_grid, low), (int(size[0]), int(size[1])), wide))
    part.factor = factor
    return part, low


def _holds(camera: Camera, frame_from_grid: Floats, grid_px: Floats) -> NDArray[np.bool_]:
    """Return (k,) whether the patches around points (k, 2) of the grid lie inside a camera's frame."""
    half = float(MARGIN_PX)
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    return np.asarray(camera.sees(_moved(frame_from_grid, grid_px[:, None] + square)).all(1))


def _scale(affine: Floats) -> float:
    """Return by which factor an affine map (2, 3) changes lengths."""
    return math.sqrt(abs(float(affine[0, 0] * affine[1, 1] - affine[0, 1] * affine[1, 0])))


def _moved(affine: Floats, px: Floats) -> Floats:
    return np.asarray(px @ affine[:, :2].T + affine[:, 2])


def _inverse(affine: Floats) -> Floats:
    back = np.linalg.inv(affine[:, :2])
    return np.column_stack([back, -back @ affine[:, 2]])


def _shifted(affine: Floats, origin: Floats) -> Floats:
    """Return an affine map for points that are counted from `origin` (2,)."""
    return np.column_stack([affine[:, :2], _moved(affine, origin)])


def in_one_exposure(pair: FramePair, box: Box, correction_px: Floats) -> FramePair:
    """Return the pair with the darker frame brought to the grey levels of the brighter one, and both limited alike.

    If the exposures are nearly equal, or if their ratio cannot be measured, the pair itself is returned.

    Args:
        pair: two frames, of the same resolution within a few per cent.
        box: the part of frame a that frame b is predicted to show.
        correction_px: (2,) difference to the prediction that a coarse search found.
    """
    a, b = pair.a.grey, pair.b.grey
    # The same part of the board in both frames, as nearly as the prediction says, in whole blocks.
    dx, dy = (round(v) for v in (pair.offset_px(box) + correction_px).tolist())
    x0, x1 = _shared(box[0], box[2], a.shape[1], b.shape[1], dx)
    y0, y1 = _shared(box[1], box[3], a.shape[0], b.shape[0], dy)
    if min(x1 - x0, y1 - y0) < 2 * _BLOCK_PX:
        return pair
    mean_a, mean_b = _block_mean(pair.a, x0, y0, x1, y1), _block_mean(pair.b, x0 + dx, y0 + dy, x1 + dx, y1 + dy)
    if min(mean_a, mean_b) > _EQUAL * max(mean_a, mean_b):
        return pair
    parts = a[y0:y1, x0:x1], b[y0 + dy : y1 + dy, x0 + dx : x1 + dx]
    first_is_dark = mean_a < mean_b
    levels = _levels(*(parts if first_is_dark else parts[::-1]))
    if levels is None:
        return pair
    ratio, offset = levels

    def limited(frame: PreparedFrame) -> PreparedFrame:
        # In this order, since the sensor also limits the brighter frame before it can be smoothed.
        grey = np.minimum(frame.grey, np.uint8(_CEILING))
        return frame.with_grey(cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX) if ratio < _NOISY else grey)

    def brightened(frame: PreparedFrame) -> PreparedFrame:
        grey = np.maximum(frame.grey.astype(np.float32) - offset, 0)
        return limited(frame.with_grey(cv2.convertScaleAbs(grey, alpha=1 / ratio)))

    if first_is_dark:
        return replace(pair, a=brightened(pair.a), b=limited(pair.b))
    return replace(pair, a=limited(pair.a), b=brightened(pair.b))


def _shared(low: int, high: int, size_a: int, size_b: int, by: int) -> tuple[int, int]:
    """Return the part from `low` to `high` of one side of frame a that frame b has too, displaced, in whole blocks."""
    first, last = max(low, 0, -by), min(high, size_a, size_b - by)
    return first, last - max(last - first, 0) % _BLOCK_PX


def _block_mean(frame: PreparedFrame, x0: int, y0: int, x1: int, y1: int) -> float:
    """Return the mean grey level of a box, to within a block, from the reduced copy that searches read as well."""
    n = _BLOCK_PX
    return float(cv2.mean(frame.reduced(n)[y0 // n : y1 // n, x0 // n : x1 // n])[0])


def _levels(dark: NDArray[np.uint8], bright: NDArray[np.uint8]) -> tuple[float, float] | None:
    """Fit the grey levels of two frames: dark = offset + ratio · bright; None if they are nearly equal or unknown.

    Return ratio and offset. Means of blocks are compared, so that a displacement of some px does not matter, and only
    blocks of which no pixel is near saturation.
    """
    blocks = (slice(None, None, _BLOCK_PX),) * 2
    # The anchor puts the pixel of each block's first corner in the middle of its window.
    usable = cv2.dilate(bright, np.ones((2 * _BLOCK_PX + 1,) * 2, np.uint8))[blocks] <= _HIGH
    x, y = (cv2.boxFilter(g, cv2.CV_32F, (_BLOCK_PX,) * 2)[blocks][usable].astype(np.float64) for g in (bright, dark))
    if len(x) < _LEAST_BLOCKS:
        return None
    together = float(((x - x.mean()) * (y - y.mean())).mean())
    # A frame that is black, or shows something else, has no ratio.
    if together <= _ALIKE * float(x.std() * y.std()) or together <= 0:
        return None
    ratio = together / float(x.var())
    return (ratio, float(y.mean() - ratio * x.mean())) if ratio < _EQUAL else None
