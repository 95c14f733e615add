"""Which good frames are confirmed: their pictures show that they belong to the row in which they are.

A frame that is black, covered, frozen or in a wrong row can be complete. It does not fit the board's motion, and no
component counts as seen in it. Links on the board and points with CAD coordinates decide; where they are few, links
beside the board, the edge of the board, and whether the frame repeats the picture of the frame before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import (
    REFERENCE,
    USED,
    AdjustmentResult,
    FiducialPoints,
    Ints,
    Observations,
)
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.outline import (
    HALF_PATCH_PX,
    beside,
    edge_profiles,
    other_steps,
    outline_polygons,
    straight_pieces,
    strongest_line,
)
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.matching.evidence import FrameKey, Method
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.matching.link import STATIC_PX, choose_corners, shows_patches
from vaoi_station.stitching.matching.patches import patch_centres

_LEAST_FITTING, _LEAST_SHARE, _DECIDING = 3, 0.5, 5
"""Least number and share of a frame's links or points that must fit; number of them that decides it.

Measured: in sound frames 0.7 or more fit. In a picture of another row, up to 7 of 31 fit by chance."""
_SURE = 12
"""Number of fitting links from which no picture of another row is to be expected."""
_BESIDE_SHARE, _BESIDE_MM, _BESIDE_OF_WAY, _ALIKE_MM = 0.7, 0.05, 0.02, 0.05
"""Of links beside the board that alone confirm a frame: least share that must fit; largest residual, constant and per
mm of the way between its rows, as they may lie below the board; largest deviation from the median of its pair."""
_EDGE_MM, _BEYOND_MM = 0.15, 0.6
"""Largest distance of the edge from its place by C, and distance from it at which its step has ended."""
_LEAST_EDGE, _STANDS_OUT = 8.0, 3.0
"""Least step of grey level at the edge, and least ratio to all other steps within 3.5 mm. Measured: 24 to 52 grey
levels and 6.5 to 7.2 times in sound frames (docs/explanation/uncertainty.md)."""
_ACROSS, _LEAST_PIECES = 0.9, 2
"""Least cosine of the angle between the outward normal of a piece and the motion, and least number of such pieces."""
_LEAST_MOVED_PX, _LEAST_SAME, _MOST_MOVED = 4 * STATIC_PX, 5, 0.5
"""Least motion of the board that two frames must show; least number of corners on it in the same place in a repeated
frame, and largest number of corners, per such one, where the motion puts them."""
_STEP_PX = 8
"""Distance of the pixels by which the contrast of a frame is measured."""
_NOISE_LEVELS, _DARK_SHARE, _SOUND_LEVELS = 8.0, 0.05, 40.0
"""Contrast of a frame without light, at most: grey levels of noise, and share of that of the sound frames beside it;
and least contrast of a frame by which one beside it can be called dark."""
_MOST_NAMED = 12


class CheckedFrames(NamedTuple):
    """The good frames of a run by what their pictures show. Those that show too little are in neither set."""

    confirmed: frozenset[FrameKey]
    refuted: frozenset[FrameKey]
    """Frames that show another part of the board than their row: they are copies, or most of their links contradict."""
    sure: frozenset[FrameKey] = frozenset()
    """Confirmed frames of which more fits than may fit by chance."""
    repeated: frozenset[FrameKey] = frozenset()
    """Refuted frames that show the moment of the frame before, in other pixels."""


class Fits(NamedTuple):
    """For each frame, the number of its links or points, and of those that fit the board's motion."""

    every: Ints
    """(cameras, rows)."""
    fitting: Ints

    @staticmethod
    def of(camera: Ints, row: Ints, every: Ints, fitting: Ints) -> Fits:
        """Add up the numbers (k,) of links or points in frames (k,), and of the fitting ones."""
        shape = int(camera.max(initial=-1)) + 1, int(row.max(initial=-1)) + 1
        at, size = camera * shape[1] + row, shape[0] * shape[1]
        each = (np.bincount(at, counts, size).astype(np.int_).reshape(shape) for counts in (every, fitting))
        return Fits(*each)

    @staticmethod
    def of_links(links: Observations, fit: NDArray[np.bool_]) -> Fits:
        """Count the links of every frame, and those that `fit` (k,)."""
        if not len(links):
            return Fits(np.zeros((0, 0), np.int_), np.zeros((0, 0), np.int_))
        first = np.flatnonzero(np.diff(links.group, prepend=-1))
        camera, row = np.concatenate(
            [[links.camera_a[first], links.p[first]], [links.camera_b[first], links.q[first]]], 1
        )
        every, fitting = np.diff(first, append=len(links)), np.add.reduceat(fit.astype(np.int_), first)
        return Fits.of(camera, row, np.tile(every, 2), np.tile(fitting, 2))

    def enough(self, least: int = _LEAST_FITTING, share: float = _LEAST_SHARE) -> set[FrameKey]:
        """Return the frames of which enough links or points fit."""
        return _frames((self.fitting >= least) & (self.fitting >= share * self.every))

    @property
    def decided(self) -> set[FrameKey]:
        """The frames whose number of links or points is large enough to decide."""
        return _frames(self.every >= _DECIDING)


def _frames(there: NDArray[np.bool_]) -> set[FrameKey]:
    return {(i, j) for i, j in np.argwhere(there).tolist()}


def check_frames(
    present: frozenset[FrameKey],
    copies: frozenset[FrameKey],
    method: Method,
    adjusted: AdjustmentResult,
    beside: Observations | None,
) -> CheckedFrames:
    """Check what the good frames show against the board's motion.

    `copies` equal the frame before in every pixel; `beside` are the links beside the board, which the adjustment left
    out, or None.
    """
    points, possible, links = adjusted.problem.fiducials, present - copies, adjusted.problem.links
    frames, decided = confirmed_by_points(points, adjusted.fiducial_px) if points is not None else (set(), set())
    sure = set(frames)
    if method.links:
        fits = Fits.of_links(links, adjusted.weight > USED)
        sure |= fits.enough(_SURE, 0.0)
        frames, decided = frames | fits.enough(), decided | fits.decided
        if beside is not None and possible - frames - decided:
            frames |= confirmed_beside(beside, adjusted.motion) & (possible - decided)
    elif method.marks:
        # Marks are far apart: nothing could confirm a frame between two of them.
        return CheckedFrames(possible, copies & present, possible)
    confirmed = frozenset(frames & possible)
    return CheckedFrames(confirmed, frozenset((copies | decided) & present - confirmed), confirmed & sure)


def confirmed_by_points(points: FiducialPoints, residual_px: Floats) -> tuple[set[FrameKey], set[FrameKey]]:
    """Return the frames that points with CAD coordinates confirm, and those with enough of them to decide it.

    One mark of the board confirms a frame. Parts at equal distances let single points of the reference fit by chance.
    """
    fit, referred = inliers(points, residual_px), points.which == REFERENCE
    camera, row = points.camera[referred], points.row[referred]
    of_reference = Fits.of(camera, row, np.ones_like(camera), fit[referred].astype(np.int_))
    marked = {(i, j) for i, j in np.stack([points.camera, points.row], 1)[fit & ~referred].tolist()}
    return marked | of_reference.enough(), of_reference.decided


def confirmed_beside(beside: Observations, motion: Motion) -> set[FrameKey]:
    """Return the frames whose links beside the board fit the motion of the board."""
    # The height of what lies beside the board is not known. It displaces links between cameras too far to compare them.
    links = beside.select(np.flatnonzero(beside.p != beside.q))
    apart_mm = motion.board(links.p, links.a_mm) - motion.board(links.q, links.b_mm)
    way_mm = np.hypot(*(links.a_mm - links.b_mm).T)
    fits = np.hypot(*apart_mm.T) <= _BESIDE_MM + _BESIDE_OF_WAY * way_mm
    # It is one plane, so that the residuals of a pair are alike. Along an edge of it, links of another row differ.
    for group in np.unique(links.group):
        mine = links.group == group
        fits[mine] &= np.hypot(*(apart_mm[mine] - np.median(apart_mm[mine], axis=0)).T) <= _ALIKE_MM
    return Fits.of_links(links, fits).enough(_DECIDING, _BESIDE_SHARE)


def linked_to_before(links: Observations, weight: Floats) -> set[FrameKey]:
    """Return the frames of which a used link leads to the frame before; `weight` (k,) are the links' robust weights."""
    used = (weight > USED) & (links.camera_a == links.camera_b) & (links.q == links.p + 1)
    pairs = np.unique(links.group[used], return_index=True)[1]
    return {(i, j) for i, j in np.stack([links.camera_b[used], links.q[used]], 1)[pairs].tolist()}


def frames_with_edge(
    frames: Iterable[FrameKey],
    plane: BoardPlane,
    cad_matrix: Floats,
    scene: Scene,
    motion: Motion,
    velocity_mm_s: Floats,
) -> frozenset[FrameKey]:
    """Return those of the frames that show an end of the board where C and the motion put it; none without an outline.

    A frame at the end of a run may show a strip of the board without a corner that is found again. The edge of the
    board that lies across the motion is elsewhere in a picture of any other moment.
    """
    pieces = straight_pieces(outline_polygons(plane.board_type), plane.board_type.mm_per_unit)
    # A board type with fixture marks describes its carrier, whose edge nothing is known of.
    if not len(pieces) or plane.board_type.fixture_marks:
        return frozenset()
    board, way, there = apply(cad_matrix, pieces), velocity_mm_s / np.hypot(*velocity_mm_s), set(scene.present)

    def shows_end(key: FrameKey, picture: FrameKey) -> bool:
        """Return whether a picture, taken as that of a frame, shows one of the board's two ends in its place."""
        alone = replace(scene, present=(key,), prepared=lambda _: scene.prepared(picture), contrasts={})
        step_mm, normal, steps = edge_profiles(board, alone, motion)
        offset = (np.arange(steps.shape[1]) - steps.shape[1] // 2) * step_mm
        known, at_edge, along = steps > 0, np.abs(offset) <= _EDGE_MM + step_mm / 2, normal @ way
        in_view = (np.abs(along) >= _ACROSS) & known[:, at_edge].all(1)
        for end in (along > 0, along < 0):
            mine = np.flatnonzero(in_view & end)
            if len(mine) < _LEAST_PIECES:
                continue
            seen = np.where(known, steps, np.nan)[mine]
            others = other_steps(plane, cad_matrix, board[mine], normal[mine, None] * offset[:, None], seen, _BEYOND_MM)
            edge, around = strongest_line(seen[:, at_edge]), strongest_line(seen[:, np.abs(offset) <= _BEYOND_MM])
            if edge >= max(_LEAST_EDGE, _STANDS_OUT * strongest_line(others), around):
                return True
        return False

    # A picture of the moment before shows what it shows in the same pixels. On a carrier, another edge than the board's
    # may then lie where that is expected (seed 104256).
    before = {key: (key[0], key[1] - 1) for key in frames}
    return frozenset(
        key for key, last in before.items() if shows_end(key, key) and not (last in there and shows_end(key, last))
    )


def repeated_frames(
    frames: Iterable[FrameKey], plane: BoardPlane, c: Floats, scene: Scene, motion: Motion
) -> frozenset[FrameKey]:
    """Return those of the frames that show the board where the frame before shows it; none without an outline.

    A camera or driver sent it twice, with noise of its own. Links fit by chance where a board has equal parts at equal
    distances, but a board that has moved shows its texture elsewhere.
    """
    # Without an outline, a bed that stands still beside the board would count as the board.
    if not outline_polygons(plane.board_type) or plane.board_type.fixture_marks:
        return frozenset()
    there = set(scene.present)

    def is_repeated(camera: int, row: int) -> bool:
        lens, before = scene.cameras[camera], scene.prepared((camera, row - 1))
        height, width = before.grey.shape
        px = patch_centres(choose_corners(before, (0, 0, width, height)))
        if not len(px):
            return False
        board_mm = motion.board(np.full(len(px), row - 1), lens.ground(px))
        on_board = ~beside(plane, c, board_mm, -HALF_PATCH_PX / lens.px_per_mm)
        px, now_px = px[on_board], lens.project(apply(motion.rows_from_tester[row], board_mm[on_board]))
        if len(px) < _LEAST_SAME or np.hypot(*(now_px - px).T).min() < _LEAST_MOVED_PX:
            return False
        grey, now = before.grey, scene.prepared((camera, row)).grey
        # A smear on the lens and a light spot stay in their place too, but then the board shows corners that moved.
        same = int(shows_patches(grey, now, px, px, STATIC_PX)[0].sum())
        return (
            same >= _LEAST_SAME and int(shows_patches(grey, now, px, now_px, STATIC_PX)[0].sum()) < _MOST_MOVED * same
        )

    return frozenset((i, j) for i, j in frames if (i, j - 1) in there and is_repeated(i, j))


@dataclass(frozen=True)
class DarkLight:
    """A light, and its rows that are black while the rows beside them are bright."""

    name: str
    rows: tuple[int, ...]
    of_rows: int
    channels: tuple[int, ...] = ()
    """The LED channels that light it; empty if they are not known."""


def dark_lights(
    scene: Scene,
    lights: Sequence[str],
    channels: Mapping[str, tuple[int, ...]],
    confirmed: Collection[FrameKey],
) -> tuple[DarkLight, ...]:
    """Return the lights with rows that are black between bright ones, in the order of their first one.

    A row is dark if none of its frames is `confirmed` and all are nearly without contrast, while the same cameras show
    contrast in the nearest sound rows before and after it: no bare belt, no covered camera. `lights` are the names of
    the lights of all rows, `channels` their LED channels as far as known.
    """
    sound = sorted({row for _, row in confirmed})
    if not lights or not sound:
        return ()
    present, contrasts = set(scene.present), dict[FrameKey, float]()

    def contrast(key: FrameKey) -> float:
        """Return the difference between bright and dark pixels of a frame, in grey levels."""
        if key not in contrasts:
            low, high = np.percentile(scene.prepared(key).grey[::_STEP_PX, ::_STEP_PX], (1, 99))
            contrasts[key] = float(high - low)
        return contrasts[key]

    def is_dark(row: int) -> bool:
        """Return whether all frames of a row are black beside the nearest sound rows before and after it."""
        beside = [near for near in sound if near < row][-1:] + [near for near in sound if near > row][:1]
        compared = 0
        for camera in {i for i, j in present if j == row}:
            bright = min((contrast((camera, near)) for near in beside if (camera, near) in present), default=0.0)
            if bright >= _SOUND_LEVELS:
                if contrast((camera, row)) > max(_NOISE_LEVELS, _DARK_SHARE * bright):
                    return False
                compared += 1
        return compared > 0

    dark: dict[str, list[int]] = {}
    # One row beyond the sound ones may still show the board. Farther away it may have left the view.
    for row in range(max(sound[0] - 1, 0), min(sound[-1] + 2, len(lights))):
        if row not in sound and is_dark(row):
            dark.setdefault(lights[row], []).append(row)
    return tuple(
        DarkLight(name, tuple(rows), lights.count(name), channels.get(name, ()))
        for name, rows in dark.items()
        if rows[0] < sound[-1] and rows[-1] > sound[0]
    )


def dark_light_reasons(dark: Sequence[DarkLight]) -> Iterator[Reason]:
    """Yield one reason for each light with dark rows. It names the light, the rows and the LED channels."""
    for light in dark:
        named = ", ".join(map(str, light.rows[:_MOST_NAMED])) + (" …" if len(light.rows) > _MOST_NAMED else "")
        subject = f"row {named} is" if len(light.rows) == 1 else f"rows {named} are"
        s = "s" if len(light.channels) > 1 else ""
        output = f" of LED channel{s} {', '.join(map(str, light.channels))}" if light.channels else ""
        yield Reason(
            ReasonCode.LIGHT_DARK,
            f"light {light.name}: {subject} dark ({len(light.rows)} of its {light.of_rows} rows), while the rows "
            f"beside are bright: check lamp, driver and cable{output}, and film the board again",
        )
