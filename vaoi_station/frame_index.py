"""Which frames of a run show a place, a line or a region of the board, and how: by lens, motion, surface and height."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.camera import camera_arrays
from vaoi_station.geometry.projection_kernels import CameraArrays, ground_to_raw
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch, Surface

Ints = NDArray[np.int_]
Box = tuple[int, int, int, int]
"""Part x0, y0, x1, y1 of a picture in pixels, ends excluded."""
FrameKey = tuple[int, int]
"""Camera and row of a frame."""

_BEYOND_PX = 3.0  # a footprint's centre up to this far outside a frame still counts as a view
_MARGIN_MM = 1.0  # least distance of a point from the border of its best frame
_FAINT = 1 / 3
"""A frame whose grey levels scatter less than this share of those of another frame is exposed too short or too long."""
_DEEPEST, _DEEPEST_VIEW = 7, 4
"""Number of times that a footprint is divided into quarters at its border: for its share, and to count its views."""
_VIEW_SHARE = 0.5  # least share of a footprint that a frame must show, for the frame to count as a view


class Pixels(Protocol):
    """A prepared frame (`stitching.matching.frames`), as far as the index reads it."""

    @property
    def grey(self) -> NDArray[np.uint8]:
        """(h, w) luminance."""

    @property
    def contrast(self) -> float:
        """Standard deviation of the grey levels."""


View = tuple[int, int, float, float]  # one view of a point: camera, row, and raw pixels x and y


@dataclass(frozen=True, eq=False)
class FootprintViews:
    """k views of points of the board, ordered by point, then by camera, then by row."""

    point: Ints  # (k,) number of the point that each view shows
    camera: Ints
    row: Ints
    place_mm: Floats
    """(k, 2) position of the point in the conveyor's plane, mm in row coordinates, in the row of the view."""
    px: Floats  # (k, 2) raw pixels. Some lie a little outside the frame

    @property
    def frames(self) -> list[FrameKey]:
        """Camera and row of each of the k views."""
        return list(zip(self.camera.tolist(), self.row.tolist(), strict=True))

    @property
    def seen_in(self) -> frozenset[FrameKey]:
        """The frames that have a view."""
        there = _table(self.camera, self.row)
        return frozenset((i, j) for i, j in np.argwhere(there).tolist())

    def without_rows(self, rows: Sequence[int]) -> FootprintViews:
        """Return the views in all rows except the given ones."""
        return self._where(~np.isin(self.row, rows)) if rows else self

    def without_frames(self, frames: Collection[FrameKey]) -> FootprintViews:
        """Return the views in all frames except the given ones."""
        if not frames or not len(self.point):
            return self
        camera, row = np.array([*frames], np.int_).T
        keep = ~_table(camera, row, int(self.camera.max()), int(self.row.max()))
        return self._where(keep[self.camera, self.row])

    def without_points(self, points: Sequence[int]) -> FootprintViews:
        """Return the views of all points except the given ones."""
        return self._where(~np.isin(self.point, points)) if points else self

    def _where(self, keep: NDArray[np.bool_]) -> FootprintViews:
        return FootprintViews(self.point[keep], self.camera[keep], self.row[keep], self.place_mm[keep], self.px[keep])

    def by_address(self, addresses: Sequence[str]) -> dict[str, tuple[View, ...]]:
        """Return the views by the address of each point: {address: ((camera, row, x, y), …)}, rounded raw pixels."""
        x, y = np.round(self.px, 4).T.tolist()
        every = list(zip(self.camera.tolist(), self.row.tolist(), x, y, strict=True))
        ends = [0, *np.cumsum(np.bincount(self.point, minlength=len(addresses))).tolist()]
        return {address: tuple(every[a:b]) for address, (a, b) in zip(addresses, pairwise(ends), strict=True)}


def _table(camera: Ints, row: Ints, last_camera: int = -1, last_row: int = -1) -> NDArray[np.bool_]:
    """Return a table of cameras and rows, at least up to the last ones, that is true for the given frames."""
    shape = max(int(camera.max(initial=-1)), last_camera) + 1, max(int(row.max(initial=-1)), last_row) + 1
    out = np.zeros(shape, np.bool_)
    out[camera, row] = True
    return out


@dataclass(frozen=True, eq=False)
class Coverage:
    """How much of each of n components the frames show."""

    share: Floats  # (n,) share of the footprint's area that the frames show together
    views: Ints  # (n,) number of frames that show at least half of the footprint
    in_one_frame: NDArray[np.bool_]  # (n,) whether one frame shows the whole footprint


@dataclass(frozen=True, eq=False)
class FrameIndex:
    """The f frames of a run, with their poses above the board."""

    cameras: Sequence[Camera]
    row_from_tester: Floats  # (m, 3, 3) the matrices D_j of all rows
    present: Sequence[FrameKey] = ()  # camera and row of the frames that count
    surface: Surface | None = None  # surface of the board; None for a board in the calibrated plane
    tester_from_cad: Floats = field(default_factory=lambda: np.eye(3))  # C; the identity if places are given in mm
    prepared: Callable[[FrameKey], Pixels] | None = None  # the pixels of a frame, for those questions that read them
    contrasts: dict[FrameKey, float] = field(default_factory=dict, repr=False)
    """Contrasts of frames that were computed before."""

    @staticmethod
    def of_result(stitch: Stitch, calibrated: Sequence[Camera]) -> FrameIndex:
        """Make the index of the frames that stitching placed; `calibrated` are the cameras with which it stitched.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.cad_matrix is None:
            raise StateError(
                "this run has no CAD mapping, so it is not known which frames show a place of the board.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        rows = np.array(stitch.row_motion, dtype=np.float64).reshape(-1, 3, 3)
        placed = [(i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None]
        cad = np.asarray(stitch.cad_matrix, dtype=np.float64)
        return FrameIndex(stitch.cameras(calibrated), rows, placed, stitch.surface, cad)

    @cached_property
    def key(self) -> Ints:
        """Camera and row (f, 2) of the frames that count."""
        return np.array(self.present, dtype=np.int_).reshape(-1, 2)

    @cached_property
    def _there(self) -> frozenset[FrameKey]:
        return frozenset(self.present)

    def places(self, camera: int, row: int) -> bool:
        """Return whether a frame counts."""
        return (camera, row) in self._there

    @cached_property
    def row_from_cad(self) -> Floats:
        """(m, 3, 3)."""
        return np.asarray(self.row_from_tester @ self.tester_from_cad)

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return float(np.mean([camera.px_per_mm for camera in self.cameras]))

    @cached_property
    def arrays(self) -> CameraArrays:
        """The cameras as compiled functions take them."""
        return camera_arrays(self.cameras)

    @cached_property
    def distorts(self) -> NDArray[np.bool_]:
        """(cameras,) whether the lens distorts at all."""
        return np.array([not camera.lens.ideal for camera in self.cameras])

    @cached_property
    def size_px(self) -> Floats:
        """Width and height (f, 2) of the frames."""
        return np.array([(c.width_px, c.height_px) for c in self.cameras], dtype=np.float64)[self.key[:, 0]]

    @cached_property
    def eye_mm(self) -> Floats:
        """Centres of the cameras (f, 3) in row coordinates; their height is NaN where it is unknown."""
        eyes = [(*c.foot_mm.tolist(), c.working_distance_mm or math.nan) for c in self.cameras]
        return np.array(eyes)[self.key[:, 0]]

    def raw_px(self, camera: int, row: int, cad: Floats, above_mm: float = 0.0) -> Floats:
        """Project CAD points (..., 2), so far above the board's surface, to raw pixels (..., 2) of a frame."""
        return self.cameras[camera].project(apply(self.row_from_cad[row], cad), above_mm + self._height_mm(cad))

    def _height_mm(self, cad: Floats) -> Floats:
        return self.surface.height_mm(cad) if self.surface is not None else np.zeros(cad.shape[:-1])

    def from_foot_mm(self, camera: int, row: int, cad: Floats) -> Floats:
        """Return where CAD points (..., 2) lie from the foot of the camera: (..., 2).

        At the foot a place is seen from straight above; a body of height h appears displaced by h · distance / working
        distance.
        """
        return apply(self.row_from_cad[row], cad) - self.cameras[camera].foot_mm

    def largest_lean(self, camera: int) -> float:
        """Return by how many mm a body 1 mm high appears displaced at most, somewhere in the frames of a camera."""
        eye = self.cameras[camera]
        return float(np.hypot(*eye.parallax(eye.ground(_corners(eye, 0.0))).T).max())

    def matrix(self, camera: int, row: int, cad_from_picture: Floats, box: Box, above_mm: float = 0.0) -> Floats:
        """Return the homography (3, 3) from pixels of a picture to raw pixels of a frame.

        It is exact at the corners of a part `box` of the picture, whose pixels lie `above_mm` above the board. Between
        them a lens or a bowed board bends the picture, by less than 0.05 px within 256 px for the lenses of such an
        array.
        """
        x0, y0, x1, y1 = box
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64) - 0.5
        raw = self.raw_px(camera, row, apply(cad_from_picture, corners), above_mm)
        matrix = _from_rectangle(raw, x1 - x0, y1 - y0)
        matrix[:, 2] -= corners[0, 0] * matrix[:, 0] + corners[0, 1] * matrix[:, 1]
        return matrix

    def cad(self, camera: int, row: int, raw_px: Floats) -> Floats:
        """Return the CAD points (k, 2) on the board's surface that raw pixels (k, 2) of a frame show."""
        eye, cad_from_row = self.cameras[camera], np.linalg.inv(self.row_from_cad[row])
        cad = apply(cad_from_row, eye.ground(raw_px))
        return cad if self.surface is None else apply(cad_from_row, eye.ground(raw_px, self.surface.height_mm(cad)))

    def outline(self, camera: int, row: int) -> Floats:
        """Return the corners (4, 2), going round, of what a frame shows of the board's plane, CAD coordinates."""
        return self.cad(camera, row, _corners(self.cameras[camera], 0.5))

    def seen_box(self, camera: int, row: int, picture_from_cad: Floats, size: tuple[int, int]) -> Box:
        """Return the part of a picture of this width and height that encloses what a frame shows; may be empty."""
        eye = self.cameras[camera]
        w, h = eye.width_px - 1.0, eye.height_px - 1.0
        border = np.array([(x * w / 4, y * h / 4) for y in range(5) for x in range(5)])
        at = apply(picture_from_cad, self.cad(camera, row, border))
        x0, y0 = np.clip(np.floor(at.min(0)).astype(int) - 1, 0, size)
        x1, y1 = np.clip(np.ceil(at.max(0)).astype(int) + 2, 0, size)
        return int(x0), int(y0), int(x1), int(y1)

    def views(self, cad: Floats) -> FootprintViews:
        """Return the views of points (n, 2) in CAD coordinates in the frames of all cameras and rows."""
        board = np.ascontiguousarray(apply(self.tester_from_cad, cad)).reshape(-1, 2)
        found = _views(board, self._height_mm(cad), self._poses)
        point, camera, row = found[:, :3].T.astype(np.int_)
        return FootprintViews(point, camera, row, found[:, 3:5].copy(), found[:, 5:].copy())

    def coverage(
        self, corners: Floats, present: Collection[FrameKey] | None = None, *, count_views: bool = True
    ) -> Coverage:
        """Compute how much of every footprint with corners (n, 4, 2), going round, the frames `present` show.

        They are all frames that count if `present` is None. Without `count_views`, a count may be too low. The
        footprint lies at the height of the board's surface at its centre. It is divided into quarters until each part
        lies inside one frame, or outside all frames, or is smaller than 1/128 of the footprint's sides.
        """
        n = len(corners)
        there = np.zeros((len(self.row_from_tester), len(self.cameras)), np.bool_)
        key = self.key if present is None else np.array([*present], np.int_).reshape(-1, 2)
        there[key[:, 1], key[:, 0]] = True
        coverage = Coverage(np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.bool_))
        if corners.size and len(there):
            height = self._height_mm(corners.mean(1))
            board = np.ascontiguousarray(apply(self.tester_from_cad, corners))
            seen = _Seen(coverage.share, coverage.views, coverage.in_one_frame)
            _cover(board, height, there, self._poses, count_views, seen)
        return coverage

    def nearest(self, board_mm: Floats) -> Ints:
        """Return for each board point (k, 2) the number of the frame that shows it nearest to its centre; −1: none.

        A frame that is almost black or saturated everywhere shows no edges: it is taken for points that no other frame
        shows. A program may give every row and camera its own exposure.
        """
        assert self.prepared is not None
        points, faint = np.ascontiguousarray(board_mm), np.zeros(len(self.key), np.bool_)
        contrast, known = dict[int, float](), self.contrasts
        none = np.full(len(points), -1)
        chosen = first = _nearest(points, self.key, self._poses, faint, none.copy())
        # Only the contrast of frames that are chosen is computed: their pixels are read next in any case.
        while new := set(np.unique(chosen[chosen >= 0]).tolist()) - set(contrast):
            for n in new:
                key = self.present[n]
                contrast[n] = known[key] = known[key] if key in known else self.prepared(key).contrast
            least = _FAINT * max(contrast.values())
            faint[[n for n, found in contrast.items() if found < least]] = True
            better = _nearest(points, self.key, self._poses, faint, none.copy()) if faint.any() else first
            chosen = np.where(better >= 0, better, first)
        return chosen

    def project(self, number: Ints, board_mm: Floats) -> Floats:
        """Project board points (k, s, 2) to raw pixels, s each to the frames numbered `number` (k,); NaN for −1."""
        return _projected(
            np.ascontiguousarray(board_mm), number, self.key, self._poses, np.full(board_mm.shape, np.nan)
        )

    def grey(self, number: Ints, px: Floats) -> Floats:
        """Read grey levels at raw pixels (k, s, 2) of the frames numbered `number` (k,), bilinearly: (k, s).

        They are NaN outside the frame, and where the number is −1.
        """
        return self.read_samples(number, px.shape[1], lambda image, mine: _bilinear(image, px[mine]))

    def read_samples(self, number: Ints, samples: int, read: Callable[[NDArray[np.uint8], Ints], Floats]) -> Floats:
        """Read s grey levels at each of k places, from the frames numbered `number` (k,): (k, samples); NaN for −1.

        `read` takes the pixels of a frame and the indices (j,) of its places, and returns their samples (j, samples).
        """
        assert self.prepared is not None
        # The loop goes frame by frame, so that each frame is fetched and prepared only once.
        out = np.full((len(number), samples), np.nan)
        order = np.argsort(number, kind="stable")
        order = order[np.searchsorted(number[order], 0) :]
        ends = np.flatnonzero(np.diff(number[order], append=-1)) + 1
        for mine in np.split(order, ends[:-1]) if len(order) else []:
            out[mine] = read(self.prepared(self.present[number[mine[0]]]).grey, mine)
        return out

    @cached_property
    def _poses(self) -> _Poses:
        sizes = [(c.width_px, c.height_px, _MARGIN_MM * c.px_per_mm) for c in self.cameras]
        rows = np.ascontiguousarray(self.row_from_tester)
        box = self._view_mm
        outer = np.concatenate([box[:, :2].min(0), box[:, 2:].max(0)])
        return _Poses(rows, self.arrays, np.array(sizes, dtype=np.float64), box, outer)

    @property
    def _view_mm(self) -> Floats:
        """(c, 4) box around what each camera sees of the board's surface, lowest x and y first, row coordinates.

        It is a little larger, since it only saves the projection of places that no frame shows.
        """
        box = np.array([c.view_mm() for c in self.cameras])
        if self.surface is not None:
            # What is seen at a height lies between the place on the calibrated plane and the foot of the camera.
            *foot, inverse = np.array([c.viewpoint for c in self.cameras]).T
            share = (np.array(self.surface.bounds_mm)[:, None] * inverse)[:, :, None, None]
            raised = box + share * (np.array(foot).T[:, None] - box)
            box = np.stack([raised[:, :, 0].min(0), raised[:, :, 1].max(0)], 1)
        beyond_mm = 2 * _BEYOND_PX / np.array([c.px_per_mm for c in self.cameras])[:, None]
        return np.concatenate([box[:, 0] - beyond_mm, box[:, 1] + beyond_mm], 1)


def _corners(camera: Camera, beyond_px: float) -> Floats:
    """Return the corners (4, 2) of a frame, so far outside of the centres of its outermost pixels."""
    low, w, h = -beyond_px, camera.width_px - 1 + beyond_px, camera.height_px - 1 + beyond_px
    return np.array([(low, low), (w, low), (w, h), (low, h)])


def _from_rectangle(target: Floats, width: float, height: float) -> Floats:
    """Return the homography (3, 3) from the corners of a rectangle at the origin, in turn, to four points (4, 2)."""
    # In closed form and with plain numbers (see `geometry.homographies`): a mosaic's tile has some ten of them.
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = target.tolist()
    right, up, rest = (x1 - x2, y1 - y2), (x3 - x2, y3 - y2), (x0 - x1 + x2 - x3, y0 - y1 + y2 - y3)
    area = right[0] * up[1] - up[0] * right[1]
    g, h = (rest[0] * up[1] - up[0] * rest[1]) / area, (right[0] * rest[1] - rest[0] * right[1]) / area
    return np.array(
        [
            [(x1 - x0 + g * x1) / width, (x3 - x0 + h * x3) / height, x0],
            [(y1 - y0 + g * y1) / width, (y3 - y0 + h * y3) / height, y0],
            [g / width, h / height, 1.0],
        ]
    )


class _Poses(NamedTuple):
    """The poses of c cameras in m rows, in the form that compiled functions take."""

    rows: Floats  # (m, 3, 3) the matrices D_j
    cameras: CameraArrays
    size_px: Floats  # (c, 3) width and height of each camera's frame, and the margin at its border
    view_mm: Floats  # (c, 4) lowest x and y, then highest x and y, of a box around each camera's view, row coordinates
    outer_mm: Floats  # (4,) the box around all of them


class _Seen(NamedTuple):
    """The arrays of a `Coverage` while they are filled."""

    share: Floats
    views: Ints
    in_one_frame: NDArray[np.bool_]


@inlined
def _to_pixel(x: float, y: float, height: float, i: int, j: int, poses: _Poses) -> tuple[float, float]:
    """Project a board point at a height to raw pixels of camera i in row j."""
    d, eye = poses.rows[j], poses.cameras.viewpoint[i]
    share = height * eye[2]
    u = (d[0, 0] * x + d[0, 1] * y + d[0, 2] - share * eye[0]) / (1 - share)
    v = (d[1, 0] * x + d[1, 1] * y + d[1, 2] - share * eye[1]) / (1 - share)
    return ground_to_raw(u, v, i, poses.cameras)


@compiled
def _views(board_mm: Floats, height: Floats, poses: _Poses) -> Floats:
    """Find the v views of board points (k, 2) at heights (k,), ordered as in `FootprintViews`.

    Returns:
        (v, 7): number of the point, camera, row, place x and y on the conveyor's plane, raw pixels x and y.
    """
    box, rows, cameras = poses.view_mm, poses.rows, len(poses.view_mm)
    outer = poses.outer_mm
    near, place, out, count = np.empty(len(rows), np.int64), np.empty((len(rows), 2)), np.empty((0, 7)), 0
    for n in range(len(board_mm)):
        x, y, found = board_mm[n, 0], board_mm[n, 1], 0
        for j in range(len(rows)):
            d = rows[j]
            u, v = d[0, 0] * x + d[0, 1] * y + d[0, 2], d[1, 0] * x + d[1, 1] * y + d[1, 2]
            # In most rows no camera sees a given point: one box around all views rules these rows out.
            if outer[0] <= u <= outer[2] and outer[1] <= v <= outer[3]:
                near[found], place[found, 0], place[found, 1] = j, u, v
                found += 1
        if count + found * cameras > len(out):
            longer = np.empty((2 * len(out) + len(board_mm) + found * cameras, 7))
            for k in range(count):
                for c in range(7):
                    longer[k, c] = out[k, c]
            out = longer
        for i in range(cameras):
            right, bottom = poses.size_px[i, 0] - 1 + _BEYOND_PX, poses.size_px[i, 1] - 1 + _BEYOND_PX
            for k in range(found):
                u, v = place[k, 0], place[k, 1]
                if not (box[i, 0] <= u <= box[i, 2] and box[i, 1] <= v <= box[i, 3]):
                    continue
                a, b = _to_pixel(x, y, height[n], i, near[k], poses)
                if -_BEYOND_PX <= a <= right and -_BEYOND_PX <= b <= bottom:
                    out[count, 0], out[count, 1], out[count, 2] = n, i, near[k]
                    out[count, 3], out[count, 4], out[count, 5], out[count, 6] = u, v, a, b
                    count += 1
    return out[:count]


@compiled
def _nearest(board_mm: Floats, frame: Ints, poses: _Poses, faint: NDArray[np.bool_], chosen: Ints) -> Ints:
    """Write the number of the frame that shows a point nearest to its centre to `chosen`, and return it."""
    for k in range(len(board_mm)):
        best = np.inf
        for n in range(len(frame)):
            if faint[n]:
                continue
            i, d, view = frame[n, 0], poses.rows[frame[n, 1]], poses.view_mm[frame[n, 0]]
            x = d[0, 0] * board_mm[k, 0] + d[0, 1] * board_mm[k, 1] + d[0, 2]
            y = d[1, 0] * board_mm[k, 0] + d[1, 1] * board_mm[k, 1] + d[1, 2]
            # The comparison in mm is cheap and rules out most frames before projection and lens are computed.
            if not (view[0] <= x <= view[2] and view[1] <= y <= view[3]):
                continue
            last_x, last_y, margin = poses.size_px[i, 0] - 1, poses.size_px[i, 1] - 1, poses.size_px[i, 2]
            u, v = _to_pixel(board_mm[k, 0], board_mm[k, 1], 0.0, i, frame[n, 1], poses)
            if min(u, v) < margin or u > last_x - margin or v > last_y - margin:
                continue
            off = (u - last_x / 2) ** 2 + (v - last_y / 2) ** 2
            if off < best:
                best, chosen[k] = off, n
    return chosen


@compiled
def _projected(board_mm: Floats, number: Ints, frame: Ints, poses: _Poses, out: Floats) -> Floats:
    for k in range(len(board_mm)):
        if number[k] >= 0:
            i, j = frame[number[k], 0], frame[number[k], 1]
            for s in range(board_mm.shape[1]):
                out[k, s, 0], out[k, s, 1] = _to_pixel(board_mm[k, s, 0], board_mm[k, s, 1], 0.0, i, j, poses)
    return out


@compiled
def _relation(corners: Floats, height: float, box: Floats, i: int, j: int, poses: _Poses) -> int:
    """Return 1 if a frame shows a part of a footprint (4, 2) wholly, −1 if it shows none of it, 0 if undecided.

    `box` (4,) holds the lowest u and v of the part, then the highest, as shares of the footprint's sides.
    """
    right, bottom = poses.size_px[i, 0] - 1, poses.size_px[i, 1] - 1
    a, b, d = corners[0], corners[1], corners[3]
    inside, left_of, right_of, above, below = 0, 0, 0, 0, 0
    for k in range(4):
        u = box[0] if k in (0, 3) else box[2]
        v = box[1] if k < 2 else box[3]
        x, y = a[0] + u * (b[0] - a[0]) + v * (d[0] - a[0]), a[1] + u * (b[1] - a[1]) + v * (d[1] - a[1])
        px, py = _to_pixel(x, y, height, i, j, poses)
        left_of += px < 0
        right_of += px > right
        above += py < 0
        below += py > bottom
        inside += px >= 0 and px <= right and py >= 0 and py <= bottom
    if inside == 4:
        return 1
    return -1 if max(left_of, right_of, above, below) == 4 else 0


@compiled
def _share_of_union(corners: Floats, height: float, near: Ints, poses: _Poses, deepest: int) -> float:
    """Return the share of a footprint that several frames show together; `near` (f, 2) holds camera and row of each."""
    # Parts that are still to be examined lie on a stack as (lowest u, lowest v, side, depth); a division adds three.
    stack = np.empty((3 * deepest + 4, 4))
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 0.0, 1.0, 0.0
    waiting, share, box = 1, 0.0, np.empty(4)
    while waiting:
        waiting -= 1
        u, v, side, depth = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2], stack[waiting, 3]
        box[0], box[1], box[2], box[3] = u, v, u + side, v + side
        if depth == deepest:
            # At the border of the frames, the middle of a smallest part decides whether the part is seen.
            box[0] = box[2] = u + side / 2
            box[1] = box[3] = v + side / 2
        covered, touched = False, False
        for f in range(len(near)):
            relation = _relation(corners, height, box, near[f, 0], near[f, 1], poses)
            covered |= relation > 0
            touched |= relation == 0
            if covered:
                break
        if covered:
            share += side * side
        elif touched and depth < deepest:
            half = side / 2
            for k in range(4):
                stack[waiting + k, 0], stack[waiting + k, 1] = u + half * (k % 2), v + half * (k // 2)
                stack[waiting + k, 2], stack[waiting + k, 3] = half, depth + 1
            waiting += 4
    return share


@compiled
def _cover(
    corners: Floats, height: Floats, there: NDArray[np.bool_], poses: _Poses, count_views: bool, seen: _Seen
) -> None:
    """Compute how much of each of n footprints the frames show, and write the values to `seen`.

    `corners` (n, 4, 2) and `height` (n,) are those of the footprints, mm; `there` (m, c) says which frames count.
    """
    view, outer, unit = poses.view_mm, poses.outer_mm, np.zeros(4)
    unit[2] = unit[3] = 1.0
    near = np.empty((there.size, 2), np.int64)
    for n in range(len(corners)):
        part, whole, border = corners[n], 0, 0
        x, y = (part[0, 0] + part[2, 0]) / 2, (part[0, 1] + part[2, 1]) / 2
        reach = math.hypot(part[0, 0] - part[2, 0], part[0, 1] - part[2, 1]) / 2
        for j in range(len(poses.rows)):
            d = poses.rows[j]
            a, b = d[0, 0] * x + d[0, 1] * y + d[0, 2], d[1, 0] * x + d[1, 1] * y + d[1, 2]
            # In most rows no camera sees a given component: one comparison rules these rows out.
            if a + reach < outer[0] or a - reach > outer[2] or b + reach < outer[1] or b - reach > outer[3]:
                continue
            for i in range(there.shape[1]):
                if not there[j, i] or a + reach < view[i, 0] or a - reach > view[i, 2]:
                    continue
                if b + reach < view[i, 1] or b - reach > view[i, 3]:
                    continue
                relation = _relation(part, height[n], unit, i, j, poses)
                whole += relation > 0
                if relation == 0:
                    near[border, 0], near[border, 1] = i, j
                    border += 1
            if whole and not count_views:
                break
        seen.views[n] = whole
        if whole:
            seen.share[n], seen.in_one_frame[n] = 1.0, True
        elif border:
            seen.share[n] = _share_of_union(part, height[n], near[:border], poses, _DEEPEST)
        if count_views:
            for k in range(border):
                shown = _share_of_union(part, height[n], near[k : k + 1], poses, _DEEPEST_VIEW)
                seen.views[n] += shown >= _VIEW_SHARE


@compiled
def _bilinear(image: NDArray[np.uint8], px: Floats) -> Floats:
    """Interpolate the grey levels (k, s) at pixels (k, s, 2) of an image; NaN outside of it."""
    h, w = image.shape
    out = np.empty(px.shape[:2])
    for k in range(len(px)):
        for s in range(px.shape[1]):
            x, y = px[k, s, 0], px[k, s, 1]
            if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
                out[k, s] = np.nan
                continue
            j, i = min(int(x), w - 2), min(int(y), h - 2)
            u, v = x - j, y - i
            above = image[i, j] * (1 - u) + image[i, j + 1] * u
            below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
            out[k, s] = above * (1 - v) + below * v
    return out
