"""What the good frames show too little of: components, frames that do not fit, cameras that delivered nothing.

How much must be seen is stated by component, board type and station (`model.Visibility`). A cause is reported only if
it was tested: the component would be seen if the lost frames had arrived, or if there were rows before or after the
filmed ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import Coverage, FrameIndex
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import VISIBILITY, BoardType, Reason, ReasonCode, Visibility
from vaoi_station.model.board_type import UnseenCause
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane, expected_angle, typical_camera
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import ComponentIndex
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

_SLACK = 1e-9
"""Rounding error that is tolerated in a sum of shares."""
_MOST_NAMED, _MOST_NAMED_FRAMES = 40, 6
"""Largest number of components, and of frames, that one reason names; `quality` of the result lists all of them."""
_MOST_ROWS = 1000
"""Largest number of rows that a test adds before or after the filmed ones."""
_EXPLANATIONS: dict[UnseenCause, str] = {
    "frames-unconfirmed": "frames that should show them fit neither the frames before and after them nor the board: "
    "check these pictures; a camera that is frozen, covered or without light sends such frames",
    "frames-lost": "repair what lost these frames and film the board again",
    "filming-ended": "the frames ended before these components had passed; check barrier, tail and number of rows, and "
    "film the board again",
    "filming-began": "the frames began after these components had passed; check barrier and start delay, and film the "
    "board again",
    "seam": "they lie on a seam or are larger than a frame; move or turn the board, or ask for less with `visibility` "
    "in the board type",
    "beyond-view": "they pass beside the cameras; move the board or the cameras, or, if this is intended, give them "
    "`visibility` with `coverage` 0 in the board type",
}


@dataclass(frozen=True)
class UnseenComponent:
    """A component of which the good frames show less than is asked for."""

    address: str
    coverage: float
    """Share of the footprint's area that the good frames show together."""
    views: int
    in_one_frame: bool
    asked: Visibility
    cause: UnseenCause

    @property
    def shortfall(self) -> str:
        """How much of it is seen, and how much is asked for, in a few words."""
        if self.asked.coverage is not None and self.coverage < self.asked.coverage - _SLACK:
            # Rounded down, so that 98.7 % is not shown as 99 % if 99 % is asked for.
            return f"{np.floor(100 * self.coverage):.0f} % of {100 * self.asked.coverage:.0f} %"
        if self.asked.views is not None and self.views < self.asked.views:
            return f"{self.views} of {self.asked.views} views"
        return "not in one frame"


class FilmedBoard(NamedTuple):
    """A board with its position, and the frames of its run."""

    parts: ComponentIndex
    frames: FrameIndex

    def coverage(self, present: Collection[FrameKey], *, count_views: bool = True) -> Coverage:
        """Compute how much of every component the frames `present` show."""
        frames = replace(self.frames, present=tuple(present))
        return frames.coverage(self.parts.corners, count_views=count_views)

    def complete(self) -> Coverage:
        """Compute how much of every component the frames of all cameras and rows would show."""
        return self.coverage(list(product(range(len(self.frames.cameras)), range(len(self.frames.row_from_tester)))))

    def with_more_rows(self, way: int, velocity_mm_s: Floats) -> FilmedBoard:
        """Return the board with rows added after the last (`way` 1) or before the first (−1), until it is not seen."""
        views, rows = np.array([camera.view_mm() for camera in self.frames.cameras]), self.frames.row_from_tester
        low, high = views[:, 0].min(0), views[:, 1].max(0)
        # A step of half the smallest view: every part of the board is then wholly in some frame.
        step = float((views[:, 1] - views[:, 0]).min()) / 2
        extent = np.ptp(self.parts.corners.reshape(-1, 2) @ self.frames.tester_from_cad[:2, :2].T, axis=0)
        count = min(int(np.ceil((float(np.hypot(*extent)) + float(np.hypot(*(high - low)))) / step)), _MOST_ROWS)
        more = np.repeat(rows[-1 if way > 0 else 0][None], count, 0)
        direction = np.asarray(velocity_mm_s) / float(np.hypot(*velocity_mm_s))
        more[:, :2, 2] += way * step * (np.arange(count) + 1)[:, None] * direction
        return self._replace(frames=replace(self.frames, row_from_tester=np.concatenate([rows, more])))


class _Asked(NamedTuple):
    """The visibility that each of n components must have, as arrays."""

    coverage: Floats
    views: NDArray[np.int_]
    in_one_frame: NDArray[np.bool_]

    @staticmethod
    def of(required: Sequence[Visibility]) -> _Asked:
        """Collect the values; most components have the same object, so that its values are read only once."""
        kinds = {id(r): r for r in required}
        number = {key: n for n, key in enumerate(kinds)}
        of = np.array([number[id(r)] for r in required], dtype=np.int_)
        values = (np.array([getattr(r, key) for r in kinds.values()]) for key in _Asked._fields)
        coverage, views, in_one_frame = (v[of] if len(of) else np.zeros(0) for v in values)
        return _Asked(coverage.astype(np.float64), views.astype(np.int_), in_one_frame.astype(np.bool_))

    def met(self, c: Coverage) -> NDArray[np.bool_]:
        return (c.share >= self.coverage - _SLACK) & (c.views >= self.views) & (c.in_one_frame | ~self.in_one_frame)

    def take(self, at: NDArray[np.int_]) -> _Asked:
        return _Asked(self.coverage[at], self.views[at], self.in_one_frame[at])


def required_visibility(board_type: BoardType, station: Visibility) -> tuple[Visibility, ...]:
    """Return the visibility that is asked for, for each component of a board type, with all values filled in."""
    general = (board_type.visibility or Visibility()).over(station).over(VISIBILITY)
    return tuple(general if c.visibility is None else c.visibility.over(general) for c in board_type.components)


def find_unseen(
    board: FilmedBoard, confirmed: Collection[FrameKey], velocity_mm_s: Floats, required: Sequence[Visibility]
) -> tuple[UnseenComponent, ...]:
    """Find the components of which the frames show less than is `required` of each, in the board type's order.

    A component counts as unseen in good frames (those of `board.frames`) that are not `confirmed`.
    """
    asked = _Asked.of(required)
    # Counting all views takes most of the time, and few board types ask for a number of views.
    at = np.flatnonzero(~asked.met(board.coverage(confirmed, count_views=bool(asked.views.any()))))
    if not len(at):
        return ()
    few = board._replace(parts=board.parts.take(at))
    seen, causes = few.coverage(confirmed), _causes(few, asked.take(at), velocity_mm_s)
    shown = few.parts.addresses, seen.share.tolist(), seen.views.tolist(), seen.in_one_frame.tolist()
    asked_of = [required[k] for k in at.tolist()]
    return tuple(UnseenComponent(*each) for each in zip(*shown, asked_of, causes, strict=True))


def _causes(board: FilmedBoard, asked: _Asked, velocity_mm_s: Floats) -> list[UnseenCause]:
    """Return the cause for each component of a board that contains only the components that are seen too little."""
    complete = board.complete()
    # Enough area, but not in one frame: more frames of these cameras would not change that.
    causes: list[UnseenCause] = [
        "seam" if enough else "beyond-view" for enough in complete.share >= asked.coverage - _SLACK
    ]

    def explain(cause: UnseenCause, at: NDArray[np.int_], holds: NDArray[np.bool_]) -> NDArray[np.int_]:
        for k in at[holds].tolist():
            causes[k] = cause
        return at[~holds]

    # The tests follow in the order of their cost. More rows are tried only where lost frames are not the cause.
    left = explain("frames-unconfirmed", np.arange(len(causes)), asked.met(board.coverage(board.frames.present)))
    left = explain("frames-lost", left, asked.met(complete)[left])
    ways: tuple[tuple[UnseenCause, int], ...] = (("filming-ended", 1), ("filming-began", -1))
    for cause, way in ways:
        if len(left):
            more = board._replace(parts=board.parts.take(left)).with_more_rows(way, velocity_mm_s)
            left = explain(cause, left, asked.take(left).met(more.complete()))
    return causes


def unseen_reasons(
    unseen: Sequence[UnseenComponent], total: int, scene: Scene, rows: int, unplaced: Collection[int] = ()
) -> Iterable[Reason]:
    """Yield one reason for each cause, with the names of the components and what to do.

    `total` is the number of components, `rows` that of rows; `unplaced` rows have good frames that are not in `scene`.
    """
    for cause, explanation in _EXPLANATIONS.items():
        mine = [u for u in unseen if u.cause == cause]
        if not mine:
            continue
        why = _why_lost(scene, rows, unplaced) if cause == "frames-lost" else explanation
        names = ", ".join(f"{u.address} {u.shortfall}" for u in mine[:_MOST_NAMED])
        names += f", and {len(mine) - _MOST_NAMED} more" if len(mine) > _MOST_NAMED else ""
        text = f"the good frames show too little of {len(mine)} of {total} components ({names}): {why}"
        yield Reason(ReasonCode.COMPONENTS_UNSEEN, text)


def _why_lost(scene: Scene, rows: int, unplaced: Collection[int]) -> str:
    """Return the explanation of components that lost frames, or frames without a position, should show."""
    # Rows that are not placed have good frames, so their cameras did not lose them.
    cameras = range(len(scene.cameras))
    there = {*scene.present, *product(cameras, unplaced)}
    words = []
    for i in cameras:
        delivered = sum((i, j) in there for j in range(rows))
        if delivered < rows:
            what = f"{delivered} of {rows} frames" if delivered else "no complete frame"
            words.append(f"camera {i} delivered {what}")
    lost = f"{', '.join(words)}: {_EXPLANATIONS['frames-lost']}" if words else ""
    return lost + (f"{'; ' if words else ''}other rows are not placed: film the board again" if unplaced else "")


def unconfirmed_reasons(
    frames: Sequence[FrameKey], copies: Collection[FrameKey], repeated: Collection[FrameKey] = ()
) -> Iterator[Reason]:
    """Yield a reason for the frames that should show components, but do not fit the board's motion.

    Of these, `copies` equal the frame before of their camera, and `repeated` show its moment in other pixels.
    """
    if not frames:
        return
    named = ", ".join(f"camera {i} row {j}" for i, j in frames[:_MOST_NAMED_FRAMES])
    more = f" and {len(frames) - _MOST_NAMED_FRAMES} more" if len(frames) > _MOST_NAMED_FRAMES else ""
    twice, again = len(set(copies) & set(frames)), len(set(repeated) & set(frames))
    same = f"; {twice} of them equal the frame before in every pixel" if twice else ""
    same += f"; {again} of them repeat the moment of the frame before" if again else ""
    yield Reason(
        ReasonCode.FRAMES_UNCONFIRMED,
        f"{len(frames)} frames that should show components fit neither the frames before and after them nor the "
        f"board ({named}{more}{same}): check these pictures; a camera that is frozen, covered or without light "
        "sends such frames",
    )


def absent_camera_reasons(
    scene: Scene, plane: BoardPlane | None, expectation: Expectation, motion: Motion
) -> list[Reason]:
    """Return one reason for each camera without a good frame; it names the fiducials that only this camera would show.

    `plane` is None if no fiducials were searched; `motion` is that by the other cameras.
    """
    delivered = {camera for camera, _ in scene.present}
    absent = [i for i in range(len(scene.cameras)) if i not in delivered]
    board_mm = expected_fiducials(plane, scene, expectation) if absent and plane is not None else None
    clauses = dict.fromkeys(absent, "")
    if plane is not None and board_mm is None:
        clauses = dict.fromkeys(absent, ": fiducials that only this camera shows cannot be found")
    elif plane is not None and board_mm is not None:
        views = scene.index(motion.rows_from_tester).views(board_mm)
        inside = np.array(
            [scene.cameras[i].sees(px) for (i, _), px in zip(views.frames, views.px, strict=True)], np.bool_
        )
        keys = [
            key for key, seen in zip(zip(views.point.tolist(), views.frames, strict=True), inside, strict=True) if seen
        ]
        # The neighbouring camera also shows a fiducial in the overlap. Only the other fiducials are lost.
        shown = {n for n, frame in keys if frame in set(scene.present)}
        for camera in absent:
            lost = sorted({n for n, (i, _) in keys if i == camera} - shown)
            names = ", ".join(plane.board_type.fiducials[n].name for n in lost)
            many = "s" if len(lost) > 1 else ""
            clauses[camera] = f", and no other camera shows the fiducial{many} {names}" if lost else ""
    return [
        Reason(ReasonCode.CAMERA_ABSENT, f"camera {camera} delivered no complete frame of this board{clause}")
        for camera, clause in clauses.items()
    ]


def expected_fiducials(plane: BoardPlane, scene: Scene, expectation: Expectation) -> Floats | None:
    """Compute the expected tester coordinates (k, 2) of the fiducials in row 0; None if no position is expected."""
    x, y = expectation.corner_mm
    if x is None or y is None:
        return None
    angle, scale = expected_angle(plane, typical_camera(scene.cameras), expectation), plane.board_type.mm_per_unit
    turn = np.array([scale * np.cos(angle), scale * np.sin(angle), 0.0, 0.0])
    low, high = plane.board_type.extent()
    corners = plane.flat(np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]))
    # For every rotation, the expectation holds the lowest x and y of the board as it lies, that is, after the rotation.
    shift = np.array((x, y)) - apply_similarity(turn, corners).min(0)
    return np.asarray(apply_similarity(turn, plane.fiducials) + shift)
