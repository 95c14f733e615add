"""What the good frames show too little of: components, and frames that do not fit.

A cause is reported only if it was tested: the component would be seen if the lost frames had arrived, or if there were
rows before or after the filmed ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import Coverage, FootprintViews, FrameIndex
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import VISIBILITY, BoardType, Reason, ReasonCode, Visibility
from vaoi_station.model.board_type import UnseenCause
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
        return self.frames.coverage(self.parts.corners, present, count_views=count_views)

    def seen_wholly(self, present: Collection[FrameKey], views: FootprintViews) -> NDArray[np.bool_]:
        """Return which components one of the frames `present` surely shows wholly, by the views of their centres."""
        cameras = self.frames.cameras
        px_per_mm, size_px = (np.array(v)[views.camera] for v in (
            [c.px_per_mm for c in cameras], [(c.width_px - 1, c.height_px - 1) for c in cameras]
        ))  # fmt: skip
        reach_px = np.hypot(*self.parts.size.T)[views.point] / 2 * self.parts.mm_per_unit * px_per_mm
        border_px = np.minimum(views.px, size_px - views.px).min(1)
        there = np.zeros((len(cameras), len(self.frames.row_from_tester)), np.bool_)
        there[tuple(np.array([*present], np.int_).reshape(-1, 2).T)] = True
        out = np.zeros(len(self.parts.addresses), np.bool_)
        # Tilted cameras and lenses enlarge a part of the picture a little.
        out[views.point[there[views.camera, views.row] & (border_px > 1 + 1.2 * reach_px)]] = True
        return out

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


class RequiredVisibility(NamedTuple):
    """The visibility that is asked for of the components of a board type, with all values filled in."""

    general: Visibility
    own: Mapping[int, Visibility]
    """That of components that ask for something else, by number."""

    def of(self, number: int) -> Visibility:
        """Return the visibility that is asked for of one component."""
        return self.own.get(number, self.general)

    def limits(self, components: int) -> Floats:
        """Return the least share, number of views, and whether in one frame (n, 3), of all components."""
        out = np.tile(_limits(self.general), (components, 1))
        for number, asked in self.own.items():
            out[number] = _limits(asked)
        return out


def _limits(asked: Visibility) -> Floats:
    return np.array([asked.coverage, asked.views, asked.in_one_frame], np.float64)


def required_visibility(board_type: BoardType, station: Visibility) -> RequiredVisibility:
    """Return the visibility that is asked for of the components of a board type."""
    general = (board_type.visibility or Visibility()).over(station).over(VISIBILITY)
    own = {n: c.visibility.over(general) for n, c in enumerate(board_type.components) if c.visibility is not None}
    return RequiredVisibility(general, own)


def find_unseen(
    board: FilmedBoard,
    confirmed: Collection[FrameKey],
    velocity_mm_s: Floats,
    required: RequiredVisibility,
    views: FootprintViews | None = None,
) -> tuple[UnseenComponent, ...]:
    """Find the components of which the frames show less than is `required` of each, in the board type's order.

    `views` are those of their centres, as far as known: a component far from the border of a frame is seen wholly.
    """
    asked = required.limits(len(board.parts.addresses))

    def met(c: Coverage, asked: Floats) -> NDArray[np.bool_]:
        return (c.share >= asked[:, 0] - _SLACK) & (c.views >= asked[:, 1]) & (c.in_one_frame >= asked[:, 2])

    at, counted = np.arange(len(asked)), bool(asked[:, 1].any())
    if views is not None and not counted:
        at = np.flatnonzero(~board.seen_wholly(confirmed, views))
    # Counting all views takes most of the time, and few board types ask for a number of views.
    at = at[~met(board._replace(parts=board.parts.take(at)).coverage(confirmed, count_views=counted), asked[at])]
    if not len(at):
        return ()
    few, asked = board._replace(parts=board.parts.take(at)), asked[at]
    seen, complete = few.coverage(confirmed), few.complete()
    # Enough area, but not in one frame: more frames of these cameras would not change that.
    causes = np.where(complete.share >= asked[:, 0] - _SLACK, "seam", "beyond-view").astype(object)
    left = np.arange(len(at))

    def explain(cause: UnseenCause, shown: Coverage) -> None:
        nonlocal left
        holds = met(shown, asked[left])
        causes[left[holds]], left = cause, left[~holds]

    # The tests follow in the order of their cost. More rows are tried only where lost frames are not the cause.
    explain("frames-unconfirmed", few.coverage(few.frames.present))
    explain("frames-lost", Coverage(complete.share[left], complete.views[left], complete.in_one_frame[left]))
    ways: tuple[tuple[UnseenCause, int], ...] = (("filming-ended", 1), ("filming-began", -1))
    for cause, way in ways:
        if len(left):
            explain(cause, few._replace(parts=few.parts.take(left)).with_more_rows(way, velocity_mm_s).complete())
    shown = few.parts.addresses, seen.share.tolist(), seen.views.tolist(), seen.in_one_frame.tolist()
    each = zip(*shown, map(required.of, at.tolist()), causes.tolist(), strict=True)
    return tuple(UnseenComponent(*one) for one in each)


def unseen_reasons(
    unseen: Sequence[UnseenComponent], total: int, scene: Scene, rows: int, unplaced: Collection[int] = ()
) -> Iterable[Reason]:
    """Yield one reason for each cause, with the names of the components, of `total`, and what to do."""
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
    """Yield a reason for the frames that should show components, but do not fit the board's motion."""
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
