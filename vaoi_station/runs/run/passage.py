"""How many boards interrupted the barrier during one run, from the times of the edges and the motion of the belt.

One board may interrupt the barrier several times, if it has cut-outs. Two boards that touch interrupt it only once.
Therefore boards are counted by length: everything within one board's length after a leading edge is the same board.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, RecordingHead, Stitch

LENGTH_SHARE, LENGTH_MM = 0.1, 5.0
"""A passage is longer than its board only if it exceeds the board's length by this share and by this length in mm.

These margins cover errors of the belt's speed between barrier and cameras, errors of the outline, and the width of the
barrier."""

PositionMm = Callable[[float], float]
"""Function from a time in s since row 0 to the distance, mm, that the belt has moved along the motion."""


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
