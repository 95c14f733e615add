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
from vaoi_station.runs.run.orders import Orders
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

    def __init__(
        self,
        line: Line,
        orders: Orders,
        publish: Callable[..., Any],
        missed: Callable[[int, str | None], object] = lambda _count, _run: None,
    ) -> None:
        """Begin without a missed board; `publish` has the signature of `EventLog.add`.

        `missed` takes a number of boards without a run of their own, and the run behind whose board they passed; None:
        they passed behind all boards so far.
        """
        self._line, self._orders, self._publish, self._passed = line, orders, publish, missed
        self.missed = 0
        """Count of boards that passed and were not filmed as a run."""
        self.reports = 0
        """Count of reports of boards without a run: a permit that was given before may have been used by one."""

    def board_missed(self, report: BoardMissed, action: str, now_s: float, code: str = "board-missed") -> None:
        """Count a board that passed without a run; `action` is what the user can do."""
        self.reports += 1
        self._orders.queue.missed(report.host_time_s, now_s)
        message = f"A board passed and was not filmed: {report.reason}"
        self._miss(1, report.host_time_s, now_s, Reason(code=code, message=message, action=action))

    def passage_missed(self, report: MissedPassage, now_s: float) -> None:
        """Count the boards that followed a missed board, which was counted when it came, within the same passage."""
        order = self._orders.next or self._orders.order
        if order is None or len(report.interruptions) == 0:
            return
        line = order.line or self._line
        end_s = max(c if c is not None else b for b, c in report.interruptions)
        way = way_of_edges(line, report.interruptions, report.ways_mm)
        passage = measure_passage(report.interruptions, end_s, way, limit_of(order.board_type, line, None))
        if passage.boards > 1:
            message = f"{_boards(passage.boards - 1)} followed a missed board too closely and passed as well."
            reason = Reason(code="boards-too-close", message=message, action=_keep_apart(line))
            self._miss(passage.boards - 1, report.host_time_s + passage.leading_s[-1], now_s, reason)

    def unwatched(self, now_s: float, why: str) -> None:
        """Record that boards may have passed without a report until now."""
        self.reports += 1
        self._orders.doubt_since_last(now_s, why)

    def begin(self, progress: Progress, *, edge_known: bool = True) -> None:
        """Record since when the order of a new run was in force, and whether its board id is certain by now.

        `edge_known` is whether the controller reported when the board interrupted the barrier.
        """
        progress.armed_s = self._orders.taken_since_s
        if why := self._orders.uncertain:
            progress.disown(why)
        if not edge_known:
            progress.add_fault(EDGE_LOST)
            progress.doubt_id("the report of the edge at which the board met the barrier was lost")
            self._orders.queue.disown(progress.run)
        self._check_id(progress)

    def end(self, progress: Progress, now_s: float) -> None:
        """Add faults of an ended run that its interruptions of the barrier show; count boards that have no run.

        Runs end in the order of their boards, so that everything about earlier boards is known here.
        """
        recorded, order = progress.recorded, progress.order
        self._check_id(progress)
        if recorded is None:
            return
        line = order.line or self._line
        of_barrier = recorded.interruptions
        passage = _passage(progress, recorded, line)
        if passage is not None and passage.boards > 1:
            lengths = ", ".join(f"{length:.0f}" for length in passage.lengths_mm)
            gaps = f" with {', '.join(f'{gap:.0f}' for gap in passage.gaps_mm)} mm between" if passage.gaps_mm else ""
            message = (
                f"{_boards(passage.boards)} passed in this run: the barrier was interrupted over {lengths} mm{gaps}, "
                f"but a board of type {order.board_type.name!r} is at most {passage.limit_mm:.0f} mm long there."
            )
            reason = Reason(code="boards-too-close", message=message, action=_keep_apart(line))
            progress.add_fault(reason)
            # The pictures may show either board, so the id may be that of the wrong one.
            progress.doubt_id("several boards passed in this run")
            self._orders.queue.disown(progress.run)
            edge_s = progress.barrier_s + passage.leading_s[-1] - of_barrier[0][0]
            self._miss(passage.boards - 1, edge_s, now_s, reason, progress.run)
        if recorded.reason == "max-rows":
            is_open = bool(of_barrier) and of_barrier[-1][1] is None
            what = "the barrier was still interrupted" if is_open else "its tail was not over"
            message = (
                f"The run ended after {recorded.head.rows} rows, the most that line.longest_board_mm = "
                f"{line.longest_board_mm:g} allows, while {what}: the rest was not filmed."
            )
            action = (
                "Check whether the board or the belt was stuck, another board followed, or the barrier is dirty; "
                "else raise line.longest_board_mm."
            )
            progress.add_fault(Reason(code="run-too-long", message=message, action=action))
            if is_open:
                # What is still in the barrier may be another board that touches the first one.
                edge_s = progress.barrier_s + of_barrier[-1][0] - of_barrier[0][0]
                self._orders.doubt(edge_s, now_s, "the barrier was still interrupted when the run before ended")

    def _check_id(self, progress: Progress) -> None:
        if (why := self._orders.doubt_of(progress.armed_s, progress.barrier_s)) is not None:
            progress.doubt_id(why)
            self._orders.queue.disown(progress.run)

    def _miss(self, count: int, edge_s: float, now_s: float, reason: Reason, run: str | None = None) -> None:
        """Count missed boards; `edge_s` is the host time of the last one's edge."""
        self.missed += count
        self._passed(count, run)
        for _ in range(count):  # one event for each: who follows the boards on the belt counts them
            self._publish("board-missed", reason.message, run=run, code=reason.code, action=reason.action)
        # This is published now: an order that comes later was given by a caller who could know of it.
        self._orders.doubt(edge_s, now_s, "a board had passed without a run of its own before")


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


def _passage(progress: Progress, recorded: RunFinished, line: Line) -> Passage | None:
    # A run that was cut short has a fault already, and the length of its last interruption is unknown.
    known = tuple(i for i in recorded.interruptions if i[1] is not None or recorded.reason == "max-rows")
    if not known:
        return None
    times_s, stitch = recorded.head.row_times_s(), progress.stitch
    if recorded.head.belt_mm is None:
        way = way_of(line, stitch, times_s)
    else:
        way = way_by_encoder(line, recorded.head, recorded.interruptions[0][0])
    return measure_passage(known, float(times_s[-1]), way, limit_of(progress.order.board_type, line, stitch))


def measure_passage(interruptions: tuple[Interruption, ...], end_s: float, way: PositionMm, limit_mm: float) -> Passage:
    """Count the boards of a run, by interruptions of the barrier in s since row 0; one at least.

    `end_s` is the end of the run, up to which an open interruption is known to last; `limit_mm` the greatest length of
    one board in the barrier.
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
    """Return the greatest length, mm, that one board or its carrier has in the barrier.

    The result gives the rotation on the belt; without one it is the expected rotation.
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
    """Return the belt's distance over time: as measured from the pictures; without a result, at the nominal speed."""
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

    `edge_s`, since row 0, is the time at which the run began by an interruption of the barrier.
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
    """Return the belt's distance over time by the encoder at each edge; without an encoder, at the nominal speed."""
    if ways_mm is None:
        return lambda time_s: line.speed_mm_s * time_s
    edges = zip(itertools.chain(*interruptions), itertools.chain(*ways_mm), strict=True)
    known = [(time_s, way_mm) for time_s, way_mm in edges if time_s is not None and way_mm is not None]
    times_s, places_mm = zip(*known, strict=True)
    return lambda time_s: float(np.interp(time_s, times_s, places_mm))


def _direction(line: Line) -> Floats:
    velocity = np.array(line.conveyor_mm_s)
    return np.asarray(velocity / np.hypot(*velocity))


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

    def add(self, report: RunFinished) -> tuple[list[Reason], list[str]]:
        """Add a run; return the warnings that begin with it, and the names of the cameras whose warnings end."""
        begun: list[Reason] = []
        ended: list[str] = []
        found: dict[int, TriggerFinding] = {}
        for finding in doubtful(report.proof):
            found.setdefault(finding.camera, finding)
        for proof in report.proof.cameras if report.proof is not None else ():
            before = self._warnings.get(proof.camera)
            if proof.camera in found:
                warning = self._warnings[proof.camera] = self._warning(report.run, found[proof.camera])
                if before is None or before.code != warning.code:
                    begun.append(warning)
            # A run without a frame of the camera shows nothing new about its trigger.
            elif before is not None and proof.frames:
                del self._warnings[proof.camera]
                ended.append(self._names[proof.camera])
        return begun, ended

    def _warning(self, run: str, finding: TriggerFinding) -> Reason:
        where = self._names[finding.camera] + ("" if finding.row is None else f", row {finding.row}")
        message = f"{where[0].upper()}{where[1:]}, run {run}: {finding.text}."
        return Reason(code=f"trigger-{finding.kind}", message=message, action=ACTIONS[finding.kind])
