"""Compute when a board interrupts and clears the barrier, and when a controller sends the pulses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from vaoi_station.line_config import ENCODER_LATENCY_S, Encoder, ExpectedBoard, Line
from vaoi_station.simulation.motion.belt import BoardMotion, board_motion
from vaoi_station.simulation.motion.encoder import EncoderTrack, encoder_track
from vaoi_station.simulation.motion.faults import extra_turn_deg, stuck_row
from vaoi_station.simulation.scenario import Scenario

_FAR_FUTURE_S = 1e4


@dataclass(frozen=True)
class Timetable:
    """The motion of one board and the times of its passage, in seconds since the start of the passage."""

    motion: BoardMotion
    turned_deg: int
    blocked_s: float
    clear_s: float
    """Time at which the board clears the barrier; infinite for a board that gets stuck in it."""
    pulse_times_s: tuple[float, ...]
    encoder: EncoderTrack | None
    """Counts of the belt's encoder; None if the line has none."""
    stuck: int | None


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
        expected_board=ExpectedBoard(center_mm=array_center_mm(scenario), rotation_deg=scenario.board.turned_deg),
    )


def array_center_mm(scenario: Scenario) -> float:
    """Return tester x of the centre of the camera array, which is also the centre of the boards' path."""
    return scenario.array.center_mm(scenario.array.cameras - 1) / 2


def timetable(scenario: Scenario, board_number: int) -> Timetable:
    """Compute the motion and the times of board `board_number`."""
    line, belt, board = scenario.line, scenario.belt, scenario.board
    turned = (board.turned_deg + extra_turn_deg(scenario.faults, board_number)) % 360
    half = (board.length_mm if turned % 180 == 0 else board.width_mm) / 2
    barrier = belt.direction * line.barrier_mm
    start_s = board_number * line.interval_s
    across = array_center_mm(scenario)
    way = board_motion(belt, board_number, start_s=start_s, start_along_mm=0.0, across_mm=across, turned_deg=turned)
    # The start position is chosen so that the board interrupts the barrier exactly `approach_s` after the start.
    way = replace(way, changes_from_s=line.approach_s)
    lead = belt.direction * way.center(line.approach_s)[1]
    way = replace(way, start_along_mm=barrier - half - lead)

    def passes(offset_mm: float) -> float:
        """Return the time at which the barrier is reached by a point `offset_mm` ahead of the board's centre."""
        return _crossing(lambda t: belt.direction * way.center(t)[1] + offset_mm - barrier)

    blocked, clear = passes(half), passes(-half)
    stuck, stop = stuck_row(scenario.faults, board_number), math.inf
    if stuck is not None:
        stop = blocked + line.start_delay_s + stuck * line.period_s
        # A board that stops after it has cleared the barrier does not interrupt the barrier again.
        clear = math.inf if stop < clear else clear
        way = replace(way, stop_s=stop)
    encoder = _encoder(scenario, replace(way, stop_s=math.inf), blocked)
    pulses = _pulses(scenario, blocked, clear, encoder)
    return Timetable(way, turned, blocked, clear, pulses, encoder, stuck)


def _encoder(scenario: Scenario, way: BoardMotion, blocked_s: float) -> EncoderTrack | None:
    """Return the counts of the belt from the start of the passage to the last row that a run may have."""
    per_mm, line = scenario.line.encoder_counts_per_mm, line_of(scenario)
    if per_mm is None:
        return None

    def way_mm(t_s: float) -> float:
        return scenario.belt.direction * (way.center(t_s)[1] - way.center(0.0)[1])

    rows_mm = (line.rows_of_longest_board + 1) * line.trigger_period_s * line.speed_mm_s
    return encoder_track(way_mm, per_mm, way_mm(blocked_s) + line.start_delay_s * line.speed_mm_s + rows_mm)


def _pulses(scenario: Scenario, blocked_s: float, clear_s: float, encoder: EncoderTrack | None) -> tuple[float, ...]:
    """Return the times of the pulses. Their number is limited to what the longest board needs."""
    line, of_line = scenario.line, line_of(scenario)
    most = of_line.rows_of_longest_board
    if encoder is not None:
        start, row, tail = of_line.encoder_places
        first = start + encoder.counts_at(blocked_s)
        last = math.inf if math.isinf(clear_s) else encoder.counts_at(clear_s) + tail
        places = (first + k * row for k in range(most))
        return tuple(encoder.time_of(place) + ENCODER_LATENCY_S for place in places if place <= last)
    times = (blocked_s + line.start_delay_s + k * line.period_s for k in range(most))
    return tuple(t for t in times if t <= clear_s + line.tail_s)


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
