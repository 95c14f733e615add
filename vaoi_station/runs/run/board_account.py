"""The account of the boards that interrupted the barrier: each one is a run, or is counted and published as missed.

A board id is armed for one board. If a board may have passed without a run, it is no longer certain to which board the
armed ids belong. This holds for all ids that were armed before the missed board was published. The runs that follow
have no board id, and their reasons state this, until a caller arms again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vaoi_station.acquisition.process.messages import BoardMissed, MissedPassage, RunFinished
from vaoi_station.line_config import Line
from vaoi_station.runs.run.order import Order, Orders
from vaoi_station.runs.run.passage import Passage, limit_of, measure_passage, way_by_encoder, way_of, way_of_edges
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.schemas import Reason

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
