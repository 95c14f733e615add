"""When a board interrupts and clears the barrier, when a controller sends the pulses, and the counts of the encoder.

Times are in seconds since the start of the passage.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.line_config import ENCODER_LATENCY_S, Encoder, ExpectedBoard, Line
from vaoi_station.simulation.motion.belt import BoardMotion
from vaoi_station.simulation.motion.faults import PassageFaults
from vaoi_station.simulation.scenario import Scenario

_FAR_FUTURE_S = 1e4
_STEP_S = 1e-3
"""Interval of the belt's way between which counts are interpolated; its speed varies over tenths of a second."""
_LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class EncoderTrack:
    """The counts of the belt's encoder during one passage, from 0 at its start."""

    steps_s: Floats
    """(k,) time of every count, the first one first."""

    @classmethod
    def of(cls, way_mm: Callable[[float], float], counts_per_mm: float, length_mm: float) -> EncoderTrack:
        """Return the counts of a belt by its way since the start, which never decreases, up to a length."""
        ends = 1.0
        while way_mm(ends) < length_mm and ends < _LONGEST_S:
            ends *= 2
        times = np.arange(0.0, ends + _STEP_S, _STEP_S)
        ways = np.array([way_mm(float(t)) for t in times])
        counts = np.arange(1, math.floor(min(length_mm, ways[-1]) * counts_per_mm) + 1)
        # Where the belt stands still, the way has one value at several times; the count comes when it moves on.
        moving = np.concatenate([[True], np.diff(ways) > 0])
        return cls(np.interp(counts / counts_per_mm, ways[moving], times[moving]))

    def counts_at(self, time_s: float) -> int:
        """Return the counts up to a time."""
        return bisect_right(self.steps_s, time_s)

    def time_of(self, counts: int) -> float:
        """Return the time at which a count is reached; infinite if it is beyond the track."""
        if counts < 1:
            return 0.0
        return float(self.steps_s[counts - 1]) if counts <= len(self.steps_s) else math.inf


@dataclass(frozen=True)
class Timetable:
    """The motion of one board and the times of its passage."""

    motion: BoardMotion
    turned_deg: int
    """Rotation of the board on the belt: 0, 90, 180 or 270 degrees, counter-clockwise as the camera sees it."""
    blocked_s: float
    clear_s: float
    """Time at which the board clears the barrier; infinite for a board that gets stuck in it."""
    pulse_times_s: tuple[float, ...]
    encoder: EncoderTrack | None
    """Counts of the belt's encoder, which space the rows; None if the controller's clock spaces them."""


def line_of(scenario: Scenario) -> Line:
    """Return the mechanics of the twin's line in the form of the `[line]` section of `station.toml`."""
    belt, line = scenario.belt, scenario.line
    per_mm = line.encoder_counts_per_mm
    return Line(
        pacing="time" if per_mm is None else "encoder",
        encoder=None if per_mm is None else Encoder(counts_per_mm=per_mm),
        conveyor_mm_s=(0.0, belt.direction * belt.speed_mm_s),
        barrier_mm=line.barrier_mm,
        start_delay_s=line.start_delay_s,
        trigger_period_s=line.period_s,
        tail_s=line.tail_s,
        longest_board_mm=line.longest_board_mm,
        debounce_s=line.debounce_s,
        expected_board=ExpectedBoard(center_mm=scenario.array.middle_mm, rotation_deg=scenario.board.turned_deg),
    )


def timetable(scenario: Scenario, board_number: int) -> Timetable:
    """Compute the motion and the times of board `board_number`."""
    line, belt, board, array = scenario.line, scenario.belt, scenario.board, scenario.array
    faults = PassageFaults(scenario.faults, board_number, 0.0)
    turned = (board.turned_deg + faults.turned_deg) % 360
    half = (board.length_mm if turned % 180 == 0 else board.width_mm) / 2
    barrier = belt.direction * line.barrier_mm
    way = BoardMotion.of(belt, board_number, board_number * line.interval_s, array.middle_mm, turned, line.approach_s)
    # The start position is chosen so that the board interrupts the barrier exactly `approach_s` after the start.
    lead = belt.direction * way.center(line.approach_s)[1]
    way = replace(way, start_along_mm=barrier - half - lead)

    def way_mm(t_s: float) -> float:
        return belt.direction * (way.center(t_s)[1] - way.center(0.0)[1])

    def passes(ahead_mm: float) -> float:
        """Return the time at which the barrier is reached by a point ahead of the board's centre."""
        return _crossing(lambda t: belt.direction * way.center(t)[1] + ahead_mm - barrier)

    blocked, clear = passes(half), passes(-half)
    of_line, encoder, stop = line_of(scenario), None, math.inf
    if line.encoder_counts_per_mm is not None:
        rows_mm = (of_line.rows_of_longest_board + 1) * of_line.trigger_period_s * of_line.speed_mm_s
        length_mm = way_mm(blocked) + of_line.start_delay_s * of_line.speed_mm_s + rows_mm
        encoder = EncoderTrack.of(way_mm, line.encoder_counts_per_mm, length_mm)
    if faults.stuck is not None:
        stop = blocked + line.start_delay_s + faults.stuck * line.period_s
        # A board that stops after it has cleared the barrier does not interrupt the barrier again.
        clear = math.inf if stop < clear else clear
    pulses = _pulses(of_line, blocked, clear, encoder)
    return Timetable(replace(way, stop_s=stop), turned, blocked, clear, pulses, encoder)


def _pulses(line: Line, blocked_s: float, clear_s: float, encoder: EncoderTrack | None) -> tuple[float, ...]:
    """Return the times of the pulses. Their number is limited to what the longest board needs."""
    most = line.rows_of_longest_board
    if encoder is None:
        times = (blocked_s + line.start_delay_s + k * line.trigger_period_s for k in range(most))
        return tuple(t for t in times if t <= clear_s + line.tail_s)
    start, row, tail = line.encoder_places
    first = start + encoder.counts_at(blocked_s)
    last = math.inf if math.isinf(clear_s) else encoder.counts_at(clear_s) + tail
    places = (first + k * row for k in range(most))
    return tuple(encoder.time_of(place) + ENCODER_LATENCY_S for place in places if place <= last)


def _crossing(ahead: Callable[[float], float]) -> float:
    """Find the time at which an increasing function becomes 0, by bisection to 1 ns."""
    low, high = 0.0, 1.0
    # The limit ends the loop for a board that never arrives.
    while ahead(high) < 0 and high < _FAR_FUTURE_S:
        high *= 2
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if ahead(middle) < 0 else (low, middle)
    return high
