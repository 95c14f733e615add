"""The boards that interrupt the barrier: how many passed in a run, which were missed, and whose ids are certain.

One board may interrupt the barrier several times, if it has cut-outs. Two boards that touch interrupt it only once.
Therefore boards are counted by length: everything within one board's length after a leading edge is the same board.

A board id is armed for one board. If a board may have passed without a run, it is no longer certain to which board the
armed ids belong. This holds for all ids that were armed before the missed board was published. The runs that follow
have no board id, and their reasons state this, until a caller arms again.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vaoi_station.acquisition.pairing.proof import ACTIONS, TriggerFinding, doubtful
from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.acquisition.process.messages import BoardMissed, MissedPassage, RunFinished
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Reason, RecordingHead, Stitch
from vaoi_station.runs.run.order import Order, Orders
from vaoi_station.runs.run.progress import Progress

UNWATCHED = frozenset({"controller-safe", "controller-reset", "events-lost"})
"""Codes of troubles during which boards may have passed without a report."""

EDGE_LOST = Reason(
    code="edge-lost",
    message=(
        "The controller's report of the edge at which this board met the barrier was lost: it is not known for which "
        "board the order was, nor whether another board followed in this run."
    ),
    action="Identify the board, check cable and load of the controller, and film it again.",
)
LENGTH_SHARE, LENGTH_MM = 0.1, 5.0
"""A passage is longer than its board only if it exceeds the board's length by this share and by this length in mm.

These margins cover errors of the belt's speed between barrier and cameras, errors of the outline, and the width of the
barrier."""

PositionMm = Callable[[float], float]
"""Function from a time in s since row 0 to the distance, mm, that the belt has moved along the motion."""


class BoardAccount:
    """Counts the boards that were missed, and decides which board ids are certain. Used by the coordinator's thread."""

    def __init__(self, line: Line, orders: Orders, publish: Callable[..., Any]) -> None:
        """Begin without a missed board.

        Args:
            line: geometry and speed of the line.
            orders: the orders in force, whose board ids become uncertain.
            publish: function that writes an event, with the signature of `EventLog.add`.
        """
        self._line, self._orders, self._publish = line, orders, publish
        self.missed = 0
        """Count of boards that passed and were not filmed as a run."""
        self.reports = 0
        """Count of reports of boards without a run: a permit that was given before may have been used by one."""

    def board_missed(self, report: BoardMissed, action: str, now_s: float) -> None:
        """Count a board that passed without a run; `action` is what the user can do."""
        self.reports += 1
        message = f"A board passed and was not filmed: {report.reason}"
        self._miss(1, (report.host_time_s, now_s), Reason(code="board-missed", message=message, action=action))

    def passage_missed(self, report: MissedPassage, now_s: float) -> None:
        """Count the boards that followed a missed board within the same passage.

        The missed board itself was counted when it came.
        """
        order = self._orders.order
        if order is None or len(report.interruptions) == 0:
            return
        line = order.line or self._line
        limit_mm = limit_of(order.board_type, line, None)
        end_s = max(c if c is not None else b for b, c in report.interruptions)
        way = way_of_edges(line, report.interruptions, report.ways_mm)
        passage = measure_passage(report.interruptions, end_s, way, limit_mm)
        if passage.boards > 1:
            message = f"{_boards(passage.boards - 1)} followed a missed board too closely and passed as well."
            edge_s = report.host_time_s + passage.leading_s[-1]
            reason = Reason(code="boards-too-close", message=message, action=_keep_apart(line))
            self._miss(passage.boards - 1, (edge_s, now_s), reason)

    def unwatched(self, now_s: float, why: str) -> None:
        """Record that boards may have passed without a report until now."""
        self.reports += 1
        self._orders.doubt_since_last(now_s, why)

    def begin(self, progress: Progress, armed_s: float, *, edge_known: bool = True) -> None:
        """Record since when the order of a new run was in force, and whether its board id is certain by now.

        `edge_known` is whether the controller reported when the board interrupted the barrier.
        """
        progress.armed_s = armed_s
        if not edge_known:
            progress.add_fault(EDGE_LOST)
            progress.doubt_id("the report of the edge at which the board met the barrier was lost")
        self._check_id(progress)

    def end(self, progress: Progress, now_s: float) -> None:
        """Add faults of an ended run that its interruptions of the barrier show; count boards that have no run.

        Runs end in the order of their boards, so that everything about earlier boards is known here.
        """
        recorded = progress.recorded
        self._check_id(progress)
        if recorded is None:
            return
        passage = self._passage(progress, recorded)
        if passage is not None and passage.boards > 1:
            reason = self._too_close(progress.order, passage)
            progress.add_fault(reason)
            # The pictures may show either board, so the id may be that of the wrong one.
            progress.doubt_id("several boards passed in this run")
            edge_s = _host_s(progress, recorded, passage.leading_s[-1])
            self._miss(passage.boards - 1, (edge_s, now_s), reason, progress.run)
        if recorded.reason == "max-rows":
            progress.add_fault(self._too_long(progress.order, recorded))
            if recorded.interruptions and recorded.interruptions[-1][1] is None:
                # What is still in the barrier may be another board that touches the first one.
                edge_s = _host_s(progress, recorded, recorded.interruptions[-1][0])
                self._orders.doubt(edge_s, now_s, "the barrier was still interrupted when the run before ended")

    def _passage(self, progress: Progress, recorded: RunFinished) -> Passage | None:
        # A run that was cut short has a fault already, and the length of its last interruption is unknown.
        known = [i for i in recorded.interruptions if i[1] is not None or recorded.reason == "max-rows"]
        if not known:
            return None
        times_s = recorded.head.row_times_s()
        stitch = progress.stitch
        line = progress.order.line or self._line
        limit_mm = limit_of(progress.order.board_type, line, stitch)
        end_s = float(times_s[-1])
        if recorded.head.belt_mm is None:
            way = way_of(line, stitch, times_s)
        else:
            way = way_by_encoder(line, recorded.head, recorded.interruptions[0][0])
        return measure_passage(tuple(known), end_s, way, limit_mm)

    def _check_id(self, progress: Progress) -> None:
        if (why := self._orders.doubt_of(progress.armed_s, progress.barrier_s)) is not None:
            progress.doubt_id(why)

    def _miss(self, count: int, times_s: tuple[float, float], reason: Reason, run: str | None = None) -> None:
        """Count missed boards; `times_s` are the host times of the last board's edge and of now."""
        self.missed += count
        self._publish("board-missed", reason.message, run=run, code=reason.code, action=reason.action)
        # This is published now: an order that comes later was given by a caller who could know of it.
        self._orders.doubt(*times_s, "a board had passed without a run of its own before")

    def _too_close(self, order: Order, passage: Passage) -> Reason:
        lengths = ", ".join(f"{length:.0f}" for length in passage.lengths_mm)
        gaps = f" with {', '.join(f'{gap:.0f}' for gap in passage.gaps_mm)} mm between" if passage.gaps_mm else ""
        return Reason(
            code="boards-too-close",
            message=(
                f"{_boards(passage.boards)} passed in this run: the barrier was interrupted over {lengths} mm{gaps}, "
                f"but a board of type {order.board_type.name!r} is at most {passage.limit_mm:.0f} mm long there."
            ),
            action=_keep_apart(order.line or self._line),
        )

    def _too_long(self, order: Order, recorded: RunFinished) -> Reason:
        open_ = bool(recorded.interruptions) and recorded.interruptions[-1][1] is None
        what = "the barrier was still interrupted" if open_ else "its tail was not over"
        return Reason(
            code="run-too-long",
            message=(
                f"The run ended after {recorded.head.rows} rows, the most that line.longest_board_mm = "
                f"{(order.line or self._line).longest_board_mm:g} allows, while {what}: the rest was not filmed."
            ),
            action=(
                "Check whether the board or the belt was stuck, another board followed, or the barrier is dirty; "
                "else raise line.longest_board_mm."
            ),
        )


def _host_s(progress: Progress, recorded: RunFinished, time_s: float) -> float:
    """Return the host time of an edge whose time is relative to row 0."""
    return progress.barrier_s + time_s - recorded.interruptions[0][0]


def _keep_apart(line: Line) -> str:
    return (
        f"Keep boards more than {line.tail_s * line.speed_mm_s:.0f} mm apart, the way of the belt in line.tail_s, "
        "and film the boards again."
    )


def _boards(count: int) -> str:
    return f"{count} boards" if count != 1 else "1 board"


class Passage(NamedTuple):
    """The boards that passed the barrier during one run, as far as its interruptions show them."""

    boards: int
    """Number of boards, at least 1."""
    leading_s: tuple[float, ...]
    """Times of the leading edges of the boards, s since row 0. Of boards that touch, only the first edge is known."""
    lengths_mm: tuple[float, ...]
    """Length of each interruption that ended; of one that has not ended, the length up to the end of the run."""
    gaps_mm: tuple[float, ...]
    """Distance between consecutive interruptions."""
    limit_mm: float
    """Greatest length of one board in the barrier, mm."""


def measure_passage(interruptions: tuple[Interruption, ...], end_s: float, way: PositionMm, limit_mm: float) -> Passage:
    """Count the boards of a run.

    Args:
        interruptions: interruptions of the barrier, s since row 0, not empty.
        end_s: time of the end of the run, up to which an open interruption is known to last.
        way: distance that the belt has moved, over time.
        limit_mm: greatest length of one board in the barrier.
    """
    spans = [(way(b), way(max(end_s, b) if c is None else c)) for b, c in interruptions]
    boards, leading, start_mm = 0, [], -math.inf
    for (blocked_s, clear_s), (from_mm, to_mm) in zip(interruptions, spans, strict=True):
        apart = from_mm - start_mm > limit_mm
        if not apart and (clear_s is None or to_mm - start_mm <= limit_mm):
            continue  # This is a later part of the same board, after a cut-out.
        if clear_s is None:
            boards += 1  # The board may be stuck, so its length shows nothing.
        elif apart:
            boards += max(1, math.ceil((to_mm - from_mm) / limit_mm))
        else:
            # It begins within the length of the board and ends beyond it: further boards touch this board, or nearly.
            boards += max(1, math.ceil((to_mm - start_mm) / limit_mm) - 1)
        start_mm = max(from_mm, to_mm - limit_mm)
        leading.append(blocked_s)
    gaps = tuple(b[0] - a[1] for a, b in itertools.pairwise(spans))
    return Passage(boards, tuple(leading), tuple(b - a for a, b in spans), gaps, limit_mm)


def limit_of(board_type: BoardType, line: Line, stitch: Stitch | None) -> float:
    """Return the greatest length that one board, or its carrier, has in the barrier, in mm.

    Args:
        board_type: gives the extent of the board.
        line: direction of the motion, expected rotation, carrier.
        stitch: the result, which gives the rotation on the belt; None to use the expected rotation.
    """
    low, high = board_type.extent()
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    from_cad = stitch.tester_from_cad if stitch is not None else None
    if from_cad is not None:
        placed = from_cad(corners)
    else:
        turn = np.deg2rad(line.expected_board.rotation_deg)
        rotation = np.array([(np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))])
        placed = corners @ rotation.T * board_type.mm_per_unit
    length_mm = float(np.ptp(placed @ _direction(line)))
    return max(length_mm, line.carrier_mm or 0.0) * (1 + LENGTH_SHARE) + LENGTH_MM


def way_of(line: Line, stitch: Stitch | None, times_s: Floats) -> PositionMm:
    """Return the belt's distance over time: as measured from the pictures; without a result, at the nominal speed.

    Args:
        line: nominal velocity.
        stitch: the result with the motion of every row.
        times_s: times of the rows, (rows,), s since row 0.
    """
    nominal_mm_s = line.speed_mm_s
    if stitch is None or len(stitch.row_motion) < 2 or len(stitch.row_motion) != len(times_s):
        return lambda time_s: nominal_mm_s * time_s
    centre_mm = np.zeros(2) if stitch.tester_from_cad is None else stitch.tester_from_cad(np.zeros(2))
    ways_mm = np.array([apply(m, centre_mm) for m in stitch.row_motion]) @ _direction(line)
    # Before the first row and after the last one, the belt is assumed to move at its mean speed.
    mean_mm_s = float((ways_mm[-1] - ways_mm[0]) / (times_s[-1] - times_s[0]))

    def way(time_s: float) -> float:
        beyond_s = min(time_s - times_s[0], 0.0) + max(time_s - times_s[-1], 0.0)
        return float(np.interp(time_s, times_s, ways_mm) + beyond_s * mean_mm_s)

    return way


def way_by_encoder(line: Line, head: RecordingHead, edge_s: float) -> PositionMm:
    """Return the belt's distance over time by its encoder, whatever the belt's speed was and however long it stood.

    Args:
        line: nominal velocity; the distance from the edge of the barrier to row 0.
        head: times of the rows, and the belt's way at each.
        edge_s: time at which the run began by an interruption of the barrier, s since row 0.
    """
    times_s, ways_mm = list(head.row_times_s()), list(head.belt_mm or ())
    row_mm = line.trigger_period_s * line.speed_mm_s
    if edge_s < times_s[0]:
        times_s, ways_mm = [edge_s, *times_s], [ways_mm[0] - line.start_delay_s * line.speed_mm_s, *ways_mm]

    def way(time_s: float) -> float:
        # The row that would come next was not due any more: the belt did not get so far.
        after_mm = min(max(time_s - times_s[-1], 0.0) * line.speed_mm_s, row_mm)
        before_mm = min(time_s - times_s[0], 0.0) * line.speed_mm_s
        return float(np.interp(time_s, times_s, ways_mm) + before_mm + after_mm)

    return way


def way_of_edges(
    line: Line, interruptions: tuple[Interruption, ...], ways_mm: tuple[Interruption, ...] | None
) -> PositionMm:
    """Return the belt's distance over time by the encoder at each edge; without an encoder, at the nominal speed.

    Args:
        line: nominal velocity.
        interruptions: interruptions of the barrier.
        ways_mm: the belt's way at the edges of each of them.
    """
    if ways_mm is None:
        return lambda time_s: line.speed_mm_s * time_s
    edges = zip(itertools.chain(*interruptions), itertools.chain(*ways_mm), strict=True)
    known = [(time_s, way_mm) for time_s, way_mm in edges if time_s is not None and way_mm is not None]
    times_s, places_mm = zip(*known, strict=True)
    return lambda time_s: float(np.interp(time_s, times_s, places_mm))


def _direction(line: Line) -> Floats:
    velocity = np.array(line.conveyor_mm_s)
    return np.asarray(velocity / np.hypot(*velocity))


class TriggerChanges(NamedTuple):
    """The warnings that begin with a run, and the names of the cameras whose warnings end with it."""

    begun: tuple[Reason, ...]
    ended: tuple[str, ...]


class TriggerWatch:
    """The doubts about each camera in its newest proof. Used by the coordinator's thread only.

    A doubt begins a warning. The next run that has frames of this camera without a doubt ends it.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Begin without doubts; `names` are the cameras' names in messages."""
        self._names = tuple(names)
        self._warnings: dict[int, Reason] = {}

    def warnings(self) -> tuple[Reason, ...]:
        """Return one warning for each camera whose frames were in doubt in the newest run that it took part in."""
        return tuple(self._warnings[camera] for camera in sorted(self._warnings))

    def add(self, report: RunFinished) -> TriggerChanges:
        """Update the warnings with the proof of a finished run."""
        if report.proof is None:
            return TriggerChanges((), ())
        found: dict[int, TriggerFinding] = {}
        for finding in doubtful(report.proof):
            found.setdefault(finding.camera, finding)
        begun, ended = [], []
        for proof in report.proof.cameras:
            camera, before = proof.camera, self._warnings.pop(proof.camera, None)
            if camera in found:
                self._warnings[camera] = self._warning(report.run, found[camera])
                if before is None or before.code != self._warnings[camera].code:
                    begun.append(self._warnings[camera])
            elif before is not None and proof.frames:
                ended.append(self._names[camera])
            elif before is not None:
                # A run without a frame of the camera shows nothing new about its trigger.
                self._warnings[camera] = before
        return TriggerChanges(tuple(begun), tuple(ended))

    def _warning(self, run: str, finding: TriggerFinding) -> Reason:
        where = self._names[finding.camera] + ("" if finding.row is None else f", row {finding.row}")
        message = f"{where[0].upper()}{where[1:]}, run {run}: {finding.text}."
        return Reason(code=f"trigger-{finding.kind}", message=message, action=ACTIONS[finding.kind])
