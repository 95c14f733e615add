"""Cameras that delivered no good frame of a run, and the fiducials that only these cameras would have shown.

Find components of which the good frames show too little, and the cause: lost frames, filming time, seams, width.

How much must be seen is stated by component, board type and station (`model.Visibility`). A cause is reported only if
it was tested: the component would be seen if the lost frames had arrived, or if there were rows before or after the
filmed ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import VISIBILITY, BoardType, Reason, ReasonCode, Surface, Visibility
from vaoi_station.model.board_type import UnseenCause
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane, expected_angle, typical_camera
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import ComponentIndex, Coverage, component_coverage
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

_SLACK = 1e-9
"""Rounding error that is tolerated in a sum of shares."""
_MOST_NAMED = 40
"""Largest number of components that one reason names; the `quality` entry of the result lists all of them."""
_MOST_NAMED_FRAMES = 6
_MOST_ROWS = 1000
"""Largest number of rows that a test adds before or after the filmed ones."""


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


class FilmedBoard(NamedTuple):
    """A board with its position and the frames of its run."""

    board_type: BoardType
    parts: ComponentIndex
    cad_matrix: Floats
    cameras: Sequence[Camera]
    rows: Floats
    """(m, 3, 3) the matrices D_j."""
    surface: Surface | None

    def coverage(self, present: Collection[FrameKey], *, count_views: bool = True) -> Coverage:
        """Compute how much of every component the frames `present` show."""
        return component_coverage(
            self.parts, self.cad_matrix, self.cameras, self.rows, present, self.surface, count_views=count_views
        )


class SeenFrames(NamedTuple):
    """The good frames of a run, and those of them that are confirmed."""

    present: Collection[FrameKey]
    """Camera and row of the good frames."""
    confirmed: Collection[FrameKey]
    """The good frames whose pictures fit the board's motion. A component in any other frame counts as unseen."""


class _Asked(NamedTuple):
    """The visibility that each of n components must have, as arrays."""

    coverage: Floats
    views: NDArray[np.int_]
    in_one_frame: NDArray[np.bool_]

    def met(self, c: Coverage) -> NDArray[np.bool_]:
        return (c.share >= self.coverage - _SLACK) & (c.views >= self.views) & (c.in_one_frame | ~self.in_one_frame)

    def take(self, at: NDArray[np.int_]) -> _Asked:
        return _Asked(self.coverage[at], self.views[at], self.in_one_frame[at])


def required_visibility(board_type: BoardType, station: Visibility) -> tuple[Visibility, ...]:
    """Return the visibility that is asked for, for each component of a board type, with all values filled in."""
    general = (board_type.visibility or Visibility()).over(station).over(VISIBILITY)
    return tuple(general if c.visibility is None else c.visibility.over(general) for c in board_type.components)


def _asked(required: Sequence[Visibility]) -> _Asked:
    # Most components have the same visibility object, so its values are read only once.
    kinds = {id(r): r for r in required}
    number = {key: n for n, key in enumerate(kinds)}
    of = np.array([number[id(r)] for r in required], dtype=np.int_)
    values = (np.array([getattr(r, key) for r in kinds.values()]) for key in ("coverage", "views", "in_one_frame"))
    coverage, views, in_one_frame = (v[of] if len(of) else np.zeros(0) for v in values)
    return _Asked(coverage.astype(np.float64), views.astype(np.int_), in_one_frame.astype(np.bool_))


def find_unseen(
    board: FilmedBoard, frames: SeenFrames, velocity_mm_s: Floats, station: Visibility
) -> tuple[UnseenComponent, ...]:
    """Find the components of which the frames show less than their visibility asks for, in the board type's order.

    Args:
        board: the board and its position.
        frames: the frames of the run.
        velocity_mm_s: (2,) nominal velocity of the conveyor.
        station: the visibility that the station asks for where the board type states none.
    """
    required = required_visibility(board.board_type, station)
    asked = _asked(required)
    # Counting all views takes most of the time, and few board types ask for a number of views.
    at = np.flatnonzero(~asked.met(board.coverage(frames.confirmed, count_views=bool(asked.views.any()))))
    if not len(at):
        return ()
    few = board._replace(parts=board.parts.take(at))
    seen = few.coverage(frames.confirmed)
    causes = _causes(few, frames.present, asked.take(at), velocity_mm_s)
    return tuple(
        UnseenComponent(
            few.parts.addresses[n],
            float(seen.share[n]),
            int(seen.views[n]),
            bool(seen.in_one_frame[n]),
            required[k],
            cause,
        )
        for n, (k, cause) in enumerate(zip(at.tolist(), causes, strict=True))
    )


def unseen_reasons(
    unseen: Sequence[UnseenComponent],
    total: int,
    cameras: int,
    rows: int,
    present: Collection[FrameKey],
    unplaced: Collection[int] = (),
) -> Iterable[Reason]:
    """Yield one reason for each cause, with the names of the components and what to do.

    Args:
        unseen: the components that the frames show too little of.
        total: number of components of the board type.
        cameras: number of cameras.
        rows: number of rows.
        present: camera and row of the good frames.
        unplaced: rows with good frames that are not placed, and therefore not in `present`.
    """
    for cause, explanation in _EXPLANATIONS.items():
        mine = [u for u in unseen if u.cause == cause]
        if mine:
            why = _why_lost(cameras, rows, present, unplaced) if cause == "frames-lost" else explanation
            yield Reason(
                ReasonCode.COMPONENTS_UNSEEN,
                f"the good frames show too little of {len(mine)} of {total} components ({_named(mine)}): {why}",
            )


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


def _causes(
    board: FilmedBoard, present: Collection[FrameKey], asked: _Asked, velocity_mm_s: Floats
) -> list[UnseenCause]:
    """Return the cause for each component of a board that contains only the components that are seen too little."""
    complete = board.coverage(_all_frames(board))
    # Enough area, but not in one frame: more frames of these cameras would not change that.
    causes: list[UnseenCause] = [
        "seam" if enough else "beyond-view" for enough in complete.share >= asked.coverage - _SLACK
    ]
    # The tests follow in the order of their cost. More rows are tried only where lost frames are not the cause.
    open_ = _explain(causes, "frames-unconfirmed", np.arange(len(causes)), asked.met(board.coverage(present)))
    open_ = _explain(causes, "frames-lost", open_, asked.met(complete)[open_])
    for cause, way in (("filming-ended", 1), ("filming-began", -1)):
        if len(open_):
            more = _with_more_rows(board._replace(parts=board.parts.take(open_)), way, velocity_mm_s)
            met = asked.take(open_).met(more.coverage(_all_frames(more)))
            open_ = _explain(causes, cast("UnseenCause", cause), open_, met)
    return causes


def _explain(
    causes: list[UnseenCause], cause: UnseenCause, at: NDArray[np.int_], holds: NDArray[np.bool_]
) -> NDArray[np.int_]:
    """Set `cause` for those components `at` (k,) for which `holds` (k,) is true, and return the others."""
    for k in at[holds].tolist():
        causes[k] = cause
    return at[~holds]


def _all_frames(board: FilmedBoard) -> list[FrameKey]:
    return [(i, j) for i in range(len(board.cameras)) for j in range(len(board.rows))]


def _with_more_rows(board: FilmedBoard, way: int, velocity_mm_s: Floats) -> FilmedBoard:
    """Return the board with rows added after the last (`way` 1) or before the first (−1) until it is out of view."""
    speed = float(np.hypot(*velocity_mm_s))
    views = np.array([camera.view_mm() for camera in board.cameras])
    low, high = views[:, 0].min(0), views[:, 1].max(0)
    # A step of half the smallest view: every part of the board is then wholly in some frame.
    step = float((views[:, 1] - views[:, 0]).min()) / 2
    at = board.parts.corners.reshape(-1, 2)
    extent = np.ptp(at @ board.cad_matrix[:2, :2].T, axis=0)
    count = min(int(np.ceil((float(np.hypot(*extent)) + float(np.hypot(*(high - low)))) / step)), _MOST_ROWS)
    end = board.rows[-1 if way > 0 else 0]
    more = np.repeat(end[None], count, 0)
    more[:, :2, 2] += way * step * (np.arange(count) + 1)[:, None] * np.asarray(velocity_mm_s) / speed
    return board._replace(rows=np.concatenate([board.rows, more]))


def _named(unseen: Sequence[UnseenComponent]) -> str:
    names = ", ".join(f"{u.address} {_shortfall(u)}" for u in unseen[:_MOST_NAMED])
    more = len(unseen) - _MOST_NAMED
    return f"{names}, and {more} more" if more > 0 else names


def _shortfall(u: UnseenComponent) -> str:
    """State in a few words how much of a component is seen, and how much is asked for."""
    if u.asked.coverage is not None and u.coverage < u.asked.coverage - _SLACK:
        # Rounded down, so that 98.7 % is not shown as 99 % if 99 % is asked for.
        return f"{np.floor(100 * u.coverage):.0f} % of {100 * u.asked.coverage:.0f} %"
    if u.asked.views is not None and u.views < u.asked.views:
        return f"{u.views} of {u.asked.views} views"
    return "not in one frame"


def _why_lost(cameras: int, rows: int, present: Collection[FrameKey], unplaced: Collection[int]) -> str:
    """Return the explanation of components that lost frames, or frames without a position, should show."""
    # Rows that are not placed have good frames, so their cameras did not lose them.
    lost = _lost_frames(cameras, rows, {*present, *product(range(cameras), unplaced)})
    lost_and_remedy = f"{lost}: {_EXPLANATIONS['frames-lost']}" if lost else ""
    apart = f"{'; ' if lost else ''}other rows are not placed: film the board again" if unplaced else ""
    return lost_and_remedy + apart


def _lost_frames(cameras: int, rows: int, present: Collection[FrameKey]) -> str:
    """Return a text that names the cameras that lost frames, and the number of these frames."""
    there = {*present}
    lost = {i: [j for j in range(rows) if (i, j) not in there] for i in range(cameras)}
    words = []
    for i, missing in lost.items():
        if len(missing) == rows:
            words.append(f"camera {i} delivered no complete frame")
        elif missing:
            words.append(f"camera {i} delivered {rows - len(missing)} of {rows} frames")
    return ", ".join(words)


def unconfirmed_reasons(
    frames: Sequence[FrameKey], copies: Collection[FrameKey], repeated: Collection[FrameKey] = ()
) -> Iterator[Reason]:
    """Yield a reason for the frames that should show components, but do not fit the board's motion.

    Args:
        frames: camera and row of these frames.
        copies: the frames of the run that equal the preceding frame of their camera.
        repeated: those that show the moment of the preceding frame in other pixels.
    """
    if not frames:
        return
    named = ", ".join(f"camera {i} row {j}" for i, j in frames[:_MOST_NAMED_FRAMES])
    more = f" and {len(frames) - _MOST_NAMED_FRAMES} more" if len(frames) > _MOST_NAMED_FRAMES else ""
    twice = len(set(copies) & set(frames))
    same = f"; {twice} of them equal the frame before in every pixel" if twice else ""
    if again := len(set(repeated) & set(frames)):
        same += f"; {again} of them repeat the moment of the frame before"
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

    Args:
        scene: the cameras and the complete frames.
        plane: plane of the board type whose fiducials were searched; None if none were searched.
        expectation: expected position of the board. If the position is unknown, no fiducials are named.
        motion: motion of the rows, from the other cameras.
    """
    delivered = {camera for camera, _ in scene.present}
    absent = [i for i in range(len(scene.cameras)) if i not in delivered]
    if not absent:
        return []
    board_mm = None if plane is None else expected_fiducials(plane, scene, expectation)
    if plane is None or board_mm is None:
        unknown = "" if plane is None else ": fiducials that only this camera shows cannot be found"
        return [_absent(i, unknown) for i in absent]
    names = np.array([f.name for f in plane.board_type.fiducials])
    # The neighbouring camera also shows a fiducial in the overlap. Only the other fiducials are lost.
    shown = np.zeros(len(names), dtype=np.bool_)
    for i, row in scene.present:
        shown |= _in_frame(scene, i, row, motion, board_mm)
    rows = range(len(motion.angle))
    hidden = {i: ~shown & np.any([_in_frame(scene, i, j, motion, board_mm) for j in rows], axis=0) for i in absent}
    return [_absent(i, _hidden_clause(names[hidden[i]].tolist())) for i in absent]


def _absent(camera: int, clause: str) -> Reason:
    return Reason(ReasonCode.CAMERA_ABSENT, f"camera {camera} delivered no complete frame of this board{clause}")


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


def _in_frame(scene: Scene, camera: int, row: int, motion: Motion, board_mm: Floats) -> np.ndarray:
    """Return for each board point (k, 2), tester mm, whether one frame shows it."""
    model = scene.cameras[camera]
    return model.sees(model.project(apply(motion.rows_from_tester[row], board_mm)))


def _hidden_clause(fiducials: list[str]) -> str:
    if not fiducials:
        return ""
    return f", and no other camera shows the fiducial{'s' if len(fiducials) > 1 else ''} {', '.join(fiducials)}"
