"""One board of two runs: its top and its bottom, joined by the id of the board and the time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field

from vaoi_station.errors import NotFoundError, VaoiError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Reason, Status, Strict
from vaoi_station.model.board_identity import CodePlace, IdentityDocument
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.kept_runs import KeptRuns
from vaoi_station.runs.states.run_ids import in_utc, utc
from vaoi_station.runs.states.schemas import FlipAxis, OrderStatus, RunSummary
from vaoi_station.runs.states.tables import FINISHED
from vaoi_station.store.run_search import MOST_SCANNED, RunFilter

SideName = Literal["top", "bottom"]
_SIDES: tuple[SideName, SideName] = ("top", "bottom")
_PAGE, _PAGES, _MOST_RUNS = 100, 5, 10
"""Runs of one id that a search returns, searches of which each reads some of the station's runs, and runs of one side
whose results are read, the newest first."""
_SAME_MM, _SQUARE_DEG = 1.0, 10.0
"""Sides of one board have outlines that differ by less, and are flipped about an axis that is so near to x or y."""
_MOST_SHARED, _MOST_NAMED = 0.1, 3
"""Share of the parts of a side that the other may list too, as logos and holes; parts that a message names."""
_DAY_S, _MOST_S = 86400.0, 1e9
Point = tuple[float, float]


def _invertible(matrix: tuple[tuple[float, float, float], ...]) -> tuple[tuple[float, float, float], ...]:
    if not abs(np.linalg.det(np.array(matrix)[:2, :2])) > 0:
        raise ValueError("the matrix has no inverse")
    return matrix


Matrix = Annotated[
    tuple[tuple[float, float, float], ...], Field(min_length=3, max_length=3), AfterValidator(_invertible)
]


class SideParts(Strict):
    """The parts of one side in columns of equal length, in CAD coordinates of the top view, mm, y up, on both sides."""

    address: tuple[str, ...]
    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]
    width_mm: tuple[float, ...] = Field(description="Of the footprint before its rotation.")
    height_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...] = Field(description="Counter-clockwise as seen from the top, on both sides.")
    unseen: tuple[str, ...] = Field(default=(), description="Addresses of parts of which the frames show too little.")
    outline_mm: tuple[Point, ...] | None = None


class BoardSide(Strict):
    """The run that shows one side of a board."""

    side: SideName
    run: str
    address: str = Field(description="Of the run; `parts`, `components` and pictures are below it.")
    station: str = Field(default="", description="Station that filmed an imported run; empty: the one that answers.")
    board_type: str
    revision: str | None = None
    started: str
    verdict: Status | None = Field(default=None, description="Absent if the run ended without a result.")
    reasons: tuple[Reason, ...] = ()
    identity: str | None = Field(default=None, description="State of its identity, if the board type has codes.")
    components: int
    extent_mm: tuple[Point, Point] | None = Field(
        default=None, description="Lowest and highest corner of the outline, CAD coordinates of the top view, mm, y up."
    )
    cad_matrix: Matrix | None = Field(
        default=None, description="C of the run, from these CAD coordinates to its tester coordinates."
    )
    turn_certain: bool = Field(default=False, description="Whether fiducials or outline exclude a turn by 180°.")
    code_at_place: bool = Field(
        default=False, description="Whether a code was read where only an unturned board has one."
    )
    flip: FlipAxis | None = Field(default=None, description="As its order states.")
    parts: SideParts | None = Field(default=None, description="With `parts=true`.")


class BoardDocument(Strict):
    """A board with both sides. CAD coordinates are those of the top view on both, so that parts have one frame."""

    board_id: str
    status: Status = Field(
        description="ok: both sides are there, are ok and agree, none is coming again, and `other_station` replies."
    )
    reasons: tuple[Reason, ...] = ()
    top: BoardSide | None = None
    bottom: BoardSide | None = None
    others: tuple[BoardSide, ...] = Field(
        default=(),
        description="Runs of this id that are not joined: earlier ones of a side, and those beyond the time.",
    )
    coming: tuple[SideName, ...] = Field(
        default=(), description="Sides that are being filmed or stitched, or for which an order waits."
    )
    flip: FlipAxis | None = Field(
        default=None,
        description="Axis of the tester about which the board was turned over from top to bottom. Absent: not known, "
        "or contradictory.",
    )
    flip_by: tuple[Literal["order", "codes", "cad"], ...] = Field(
        default=(), description="What states it: an order; codes at their places; fiducials or outlines."
    )
    flip_axis_deg: float | None = Field(default=None, description="The same axis as measured, from x, 0 to 180.")

    @property
    def every_side(self) -> tuple[BoardSide, ...]:
        """The runs of both sides, and those that are not joined."""
        return tuple(side for side in (self.top, self.bottom, *self.others) if side is not None)

    def without_parts(self) -> BoardDocument:
        """Return the document without the parts of its sides."""
        sides = {"top": self.top, "bottom": self.bottom}
        return self.model_copy(update={n: s and s.model_copy(update={"parts": None}) for n, s in sides.items()})


class FoundSides(NamedTuple):
    """The runs of a board, newest first, their board types by run, and the sides that are not finished yet."""

    sides: list[BoardSide]
    runs: dict[str, FinishedRun]
    coming: tuple[SideName, ...]
    among: str = ""
    """Of which runs these are, for a message, if not all were searched."""

    def with_parts(self, side: BoardSide) -> BoardSide:
        """Return a side with its parts; one of another station as it is."""
        if side.parts is not None or side.run not in self.runs:
            return side
        run = self.runs[side.run]
        parts = parts_of(run.board_type, tuple(part.address for part in run.detail.unseen))
        return side.model_copy(update={"parts": parts})


class Line(NamedTuple):
    """What a station knows of its runs and orders: its searches, and the state of one run, board type or the queue."""

    kept: KeptRuns
    finished: Callable[[str], FinishedRun]
    board_type: Callable[[str], BoardType]
    orders: tuple[OrderStatus, ...]


def find_sides(board_id: str, line: Line, within_s: float, prefix: str) -> FoundSides:
    """Return the runs of a board by the id that was armed, read or reported, or that a waiting order states.

    `prefix` is the address of all runs. Raise NotFoundError if there is nothing.
    """
    sides, runs, coming = list[BoardSide](), dict[str, FinishedRun](), list[SideName]()
    search, many = _Search(board_id, line.kept), Counter[SideName]()
    for run in search.runs(within_s, lambda: {side.side for side in sides} == set(_SIDES)):
        shows = _side_of(run.board_type, line)
        if run.state not in FINISHED:
            coming += shows
            continue
        many.update(shows)
        if any(many[side] > _MOST_RUNS for side in shows):
            continue
        with suppress(VaoiError):  # It was forgotten meanwhile.
            runs[run.id] = line.finished(run.id)
            sides.append(side_of(runs[run.id], f"{prefix}/{run.id}"))
    coming += [order.side for order in line.orders if order.board_id == board_id]
    if not sides and not coming:
        raise NotFoundError(
            f"No finished run shows a board with the id {board_id!r}{search.among}.",
            action="Check the id; runs?board_id= and runs?read_id= search for it.",
            code="unknown-board",
        )
    sides.sort(key=lambda side: side.started, reverse=True)
    return FoundSides(sides, runs, tuple(side for side in _SIDES if side in coming), search.among)


class _Search:
    """The search for the runs of a board, in a bounded number of pages."""

    def __init__(self, board_id: str, kept: KeptRuns) -> None:
        self._id, self._kept = board_id, kept
        self.among = ""
        """Where it ended, for a message, if there were more runs."""

    def runs(self, within_s: float, complete: Callable[[], bool]) -> Iterator[RunSummary]:
        """Yield the runs within the time of the newest one, then older ones too unless the board is complete."""
        found = self._pages(lambda before: self._kept.with_id(self._id, RunFilter(), _PAGE, before))
        newest = self._by_id(None, 1)
        seen = set[str]()
        if not (found := [*found, *newest]):
            return
        last = max(datetime.fromisoformat(run.started) for run in found)
        # A search that is bounded by time reads few of the station's runs.
        for since in (in_utc(last - timedelta(seconds=min(within_s, _MOST_S))), None):
            found += self._by_id(None if since is None else utc(since), _PAGE)
            new = {run.id: run for run in found if run.id not in seen}
            seen.update(new)
            yield from sorted(new.values(), key=lambda run: run.started, reverse=True)
            if complete():
                return

    def _by_id(self, since: str | None, most: int) -> list[RunSummary]:
        """Return the newest runs for which the id was armed; at most one if `most` is 1."""
        wanted = RunFilter(board_id=self._id, since=since)
        return self._pages(lambda before: self._kept.history.find(wanted, most, before), first=most == 1)

    def _pages(
        self, find: Callable[[str | None], tuple[Sequence[RunSummary], str | None]], *, first: bool = False
    ) -> list[RunSummary]:
        found, before = list[RunSummary](), None
        for _ in range(_PAGES):
            runs, before = find(before)
            found += runs
            if before is None or (first and found):
                return found
        self.among = f" among the newest {_PAGES * MOST_SCANNED} runs of the station, or {_PAGES * _PAGE} of this id"
        return found


def _side_of(board_type: str, line: Line) -> list[SideName]:
    try:
        return [line.board_type(board_type).side]
    except VaoiError:  # It was deleted while its board passes.
        return []


def side_of(known: FinishedRun, address: str) -> BoardSide:
    """Return the side of a board that a run shows."""
    detail, board, stitch, up = known.detail, known.board_type, known.stitch, _mm_up(known.board_type)
    matrix = None
    if stitch is not None and stitch.cad_matrix is not None:
        # From mm with y up, as the extent: the two sides may be of different units and axes.
        matrix = tuple(map(tuple, (np.asarray(stitch.cad_matrix) @ np.diag([*(1 / up), 1.0])).tolist()))
    corners = None if board.outline is None else np.sort(np.array(board.extent()) * up, axis=0).round(4).tolist()
    return BoardSide(
        side=board.side,
        run=detail.id,
        address=address,
        station=detail.origin.station if detail.origin else "",
        board_type=board.name,
        revision=board.revision,
        started=detail.started,
        verdict=detail.verdict,
        reasons=detail.reasons,
        identity=None if known.identity is None else known.identity.state,
        components=len(board.components),
        extent_mm=None if corners is None else tuple(map(tuple, corners)),
        cad_matrix=matrix,
        turn_certain=stitch is not None and stitch.quality.get("orientation") == "certain",
        code_at_place=known.identity is not None and code_at_place(board, known.identity),
        flip=detail.flip,
    )


def parts_of(board: BoardType, unseen: tuple[str, ...] = ()) -> SideParts:
    """Return the parts of a side in the coordinates that both sides have in common."""
    up, parts = _mm_up(board), board.components
    places = np.array([part.center for part in parts], dtype=np.float64).reshape(-1, 2) * up
    sizes = np.array([(part.width, part.height) for part in parts], dtype=np.float64).reshape(-1, 2) * up[0]
    outline = None if board.outline is None else (np.array(board.outline) * up).round(4).tolist()
    return SideParts(
        address=tuple([part.address for part in parts]),
        x_mm=tuple(places[:, 0].round(4).tolist()),
        y_mm=tuple(places[:, 1].round(4).tolist()),
        width_mm=tuple(sizes[:, 0].round(4).tolist()),
        height_mm=tuple(sizes[:, 1].round(4).tolist()),
        rotation_deg=tuple([part.rotation for part in parts]),
        unseen=unseen,
        outline_mm=None if outline is None else tuple(map(tuple, outline)),
    )


def _mm_up(board: BoardType) -> Floats:
    """Return the factors of x and y that take CAD coordinates to mm with y up."""
    return np.array([1.0, 1.0 if board.y_axis == "up" else -1.0]) * board.mm_per_unit


def code_at_place(board: BoardType, identity: IdentityDocument) -> bool:
    """Return whether a code was read at a place that would be none if the board lay turned by 180°."""
    places = () if board.identity is None else board.identity.places
    read = [np.array(code.center) for code in identity.codes] if places else []
    centre = np.sum(board.extent(), axis=0) if read else np.zeros(2)

    def within(place: CodePlace, point: Floats) -> bool:
        return bool((np.abs(point - place.center) <= np.array([place.width, place.height]) / 2).all())

    return any(
        any(within(place, point) for place in places) and not any(within(place, centre - point) for place in places)
        for point in read
    )


def join_sides(
    board_id: str,
    sides: Sequence[BoardSide],
    within_s: float,
    coming: Sequence[SideName] = (),
    with_parts: Callable[[BoardSide], BoardSide] = lambda side: side,
    *,
    among: str = "",
    more: Sequence[Reason] = (),
) -> BoardDocument:
    """Join the newest run of each side; what is missing or contradicts is among the reasons.

    `with_parts` adds the parts to a side that is joined, if it has none; `among` says which runs were searched if not
    all were; `more` are further reasons.
    """
    ordered = sorted({_key(side): side for side in reversed(sides)}.values(), key=_time, reverse=True)
    recent = [side for side in ordered if _time(ordered[0]) - _time(side) <= within_s]
    found = {side.side: with_parts(side) for side in reversed(recent)}
    chosen = {_key(side) for side in found.values()}
    others = tuple(side.model_copy(update={"parts": None}) for side in ordered if _key(side) not in chosen)
    reasons = [
        reason
        for name in _SIDES
        for reason in (
            _of_side(found[name], recent, coming)
            if name in found
            else _of_missing(name, recent, others, coming, (within_s, among))
        )
    ]
    top, bottom = found.get("top"), found.get("bottom")
    flip = _Flip()
    if top is not None and bottom is not None:
        reasons += _differences(top, bottom)
        flip = _flip(top, bottom, reasons)
    reasons += more
    worst = Status.FAILED if any(reason.code == "side-failed" for reason in reasons) else Status.DEGRADED
    return BoardDocument(
        board_id=board_id,
        status=worst if reasons else Status.OK,
        reasons=tuple(reasons),
        top=top,
        bottom=bottom,
        others=others,
        coming=tuple(name for name in _SIDES if name in coming),
        flip=flip.axis,
        flip_by=flip.by,
        flip_axis_deg=flip.axis_deg,
    )


def _of_side(side: BoardSide, recent: Sequence[BoardSide], coming: Sequence[SideName]) -> list[Reason]:
    """Return what one side has against it."""
    what, reasons = f"the {side.side}, run {side.run}", list[Reason]()
    if side.verdict in (None, Status.FAILED):
        message = f"{what}, {'ended without a result' if side.verdict is None else 'failed'}"
        reasons.append(Reason(code="side-failed", message=message, action="Film it again."))
    elif side.verdict is Status.DEGRADED:
        message = f"{what}, is degraded"
        reasons.append(Reason(code="side-degraded", message=message, action="See the reasons of the run."))
    if side.side in coming:
        reasons.append(_coming(side.side))
    elif side.identity == "pending":
        message = f"the codes of the {side.side}, run {side.run}, are being read"
        reasons.append(Reason(code="side-coming", message=message, action="Wait until they are read."))
    if side.identity == "differs":
        message = f"the codes of the {side.side}, run {side.run}, state another id"
        reasons.append(Reason(code="side-of-other-board", message=message, action="Identify the board."))
    twice = [run for run in recent if run.side == side.side and _key(run) != _key(side)]
    if len({run.side for run in recent}) > 1 and (good := [run.run for run in twice if run.verdict is Status.OK]):
        message = f"the {side.side} was filmed again although run {good[0]} of it is ok; {side.run} is the newest"
        action = "Check that no two boards have this id, or go on with the newest."
        reasons.append(Reason(code="side-seen-twice", message=message, action=action))
    return reasons


def _coming(name: SideName) -> Reason:
    message = f"the {name} is being filmed or stitched, or an order waits for it"
    return Reason(code="side-coming", message=message, action="Wait until its run has finished.")


def _of_missing(
    name: SideName,
    recent: Sequence[BoardSide],
    others: Sequence[BoardSide],
    coming: Sequence[SideName],
    searched: tuple[float, str],
) -> list[Reason]:
    """Return why a side is not there. `searched` is the time between sides, and which runs were searched."""
    within_s, among = searched
    if name in coming:
        return [_coming(name)]
    if len({(run.board_type, run.station, run.address.rpartition("/")[0]) for run in recent}) > 1:
        both = " and ".join(f"{run.run} ({run.board_type!r})" for run in recent[:2])
        message = f"runs {both} both show the {recent[0].side}"
        action = "Check the key `side` of both board types, and which side each station films."
        return [Reason(code="sides-same", message=message, action=action)]
    old = next((run for run in others if run.side == name), None)
    if old is not None:
        apart_s = _time(recent[0]) - _time(old)
        apart = f"{apart_s / _DAY_S:.1f} days" if apart_s > _DAY_S else f"{apart_s:.0f} s"
        message = f"the {name}, run {old.run}, was filmed {apart} before the other side; the limit is {within_s:g} s"
        action = "Check clocks, and that no two boards have this id; film it again, or ask for a longer time."
        return [Reason(code="side-too-old", message=message, action=action)]
    message = f"no run shows the {name}{among}"
    reasons = [Reason(code="side-missing", message=message, action="Film it, or ask the station that films it.")]
    if len(recent) > 1 and all(run.verdict is Status.OK for run in recent):
        message = f"the {recent[0].side} was filmed {len(recent)} times, each time with the verdict ok"
        action = "Check that no two boards have this id."
        reasons.append(Reason(code="side-seen-twice", message=message, action=action))
    return reasons


def _differences(top: BoardSide, bottom: BoardSide) -> list[Reason]:
    """Return what speaks against both sides being of one product."""
    types, reasons = f"{top.board_type!r} and {bottom.board_type!r}", list[Reason]()
    one_product = "Check that both board types are of one product."
    if None not in (top.revision, bottom.revision) and top.revision != bottom.revision:
        message = f"{types} are of revisions {top.revision!r} and {bottom.revision!r}"
        action = "Check the board; import both sides from the data of one revision."
        reasons.append(Reason(code="sides-other-revision", message=message, action=action))
    if top.extent_mm is not None and bottom.extent_mm is not None:
        a, b = np.array(top.extent_mm), np.array(bottom.extent_mm)
        apart, moved = float(np.abs(np.ptp(a, axis=0) - np.ptp(b, axis=0)).max()), float(np.abs(a - b).max())
        if apart > _SAME_MM:
            message = f"the outlines of {types} differ by {apart:.1f} mm"
            reasons.append(Reason(code="sides-differ", message=message, action=one_product))
        elif moved > _SAME_MM:
            message = f"the outlines of {types} are of one size, but {moved:.1f} mm apart"
            action = "Import both sides from one file: both need the CAD coordinates of the top view, with one origin."
            reasons.append(Reason(code="sides-differ", message=message, action=action))
    if top.parts is not None and bottom.parts is not None:
        shared = sorted(set(top.parts.address).intersection(bottom.parts.address))
        if len(shared) > _MOST_SHARED * min(len(top.parts.address), len(bottom.parts.address)):
            names = ", ".join(shared[:_MOST_NAMED]) + (" …" if len(shared) > _MOST_NAMED else "")
            message = f"{len(shared)} parts are on both sides, as {names}; {types} list them"
            reasons.append(Reason(code="sides-differ", message=message, action=one_product))
    return reasons


class _Flip(NamedTuple):
    axis: FlipAxis | None = None
    by: tuple[Literal["order", "codes", "cad"], ...] = ()
    axis_deg: float | None = None


def _flip(top: BoardSide, bottom: BoardSide, reasons: list[Reason]) -> _Flip:
    """Return how the board was turned over; what contradicts is added to the reasons."""
    stated = sorted({side.flip for side in (top, bottom) if side.flip is not None})
    order = stated[0] if len(stated) == 1 else None
    if len(stated) > 1:
        message = "the orders of both sides state different axes about which the board was turned over"
        reasons.append(Reason(code="flip-contradicts", message=message, action="Correct `flip` of the orders."))
        return _Flip()
    if top.cad_matrix is None or bottom.cad_matrix is None:
        return _Flip(order, ("order",) if order else ())
    measured, axis_deg = _measured_flip(top.cad_matrix, bottom.cad_matrix, reasons)
    if measured is None:
        return _Flip(axis_deg=axis_deg)
    if order is not None and order != measured:
        doubtful = " and ".join(side.side for side in (top, bottom) if not _certain(side))
        why = f"the {doubtful} may lie turned by 180°, which its fiducials do not exclude" if doubtful else ""
        message = f"the order states a flip about {order}, the pictures show one about {measured}"
        action = "Check how the board lay, and `flip` of the order; do not use positions of either side until then."
        reasons.append(Reason(code="flip-contradicts", message="; ".join(filter(None, (message, why))), action=action))
        return _Flip(axis_deg=axis_deg)
    if order is None and (doubtful := " and ".join(s.side for s in (top, bottom) if not _certain(s))):
        message = f"nothing tells about which axis the board was turned over: the {doubtful} may lie turned by 180°"
        action = "State `flip` in the order, or describe a code or an unsymmetrical fiducial in the board type."
        reasons.append(Reason(code="flip-unknown", message=message, action=action))
        return _Flip()
    certain = _certain(top) and _certain(bottom)  # One side that may lie turned leaves the axis to the order.
    witnesses = (
        ("order", order is not None),
        ("codes", certain and (top.code_at_place or bottom.code_at_place)),
        ("cad", certain and (top.turn_certain or bottom.turn_certain)),
    )
    return _Flip(measured, tuple(name for name, says in witnesses if says), axis_deg)  # type: ignore[misc]


def _measured_flip(top: Matrix, bottom: Matrix, reasons: list[Reason]) -> tuple[FlipAxis | None, float | None]:
    """Return the axis that C of both sides states, and its angle."""
    (a, _), (b, _) = change = np.array(bottom)[:2, :2] @ np.linalg.inv(np.array(top)[:2, :2])
    if np.linalg.det(change) > 0:
        message = "both runs see the board from the same side, or their tester coordinates differ in handedness"
        action = "Check the key `side` of both board types."
        reasons.append(Reason(code="sides-not-flipped", message=message, action=action))
        return None, None
    # A reflection about a line at the angle t takes the x axis to the angle 2 t.
    axis_deg = round(math.degrees(math.atan2(b, a)) / 2 % 180, 3)
    if abs((axis_deg + 45) % 90 - 45) > _SQUARE_DEG:
        message = f"the board was flipped about an axis at {axis_deg:.1f}°, neither along x nor along y"
        action = "Check that both runs are of one board."
        reasons.append(Reason(code="sides-not-flipped", message=message, action=action))
        return None, axis_deg
    return ("y" if 45 < axis_deg < 135 else "x"), axis_deg


def _certain(side: BoardSide) -> bool:
    return side.turn_certain or side.code_at_place


def _key(side: BoardSide) -> tuple[str, ...]:
    """Return what is alike where two stations know one run, because one has imported it."""
    return side.run, side.started, side.side


def _time(side: BoardSide) -> float:
    return datetime.fromisoformat(side.started).timestamp()
