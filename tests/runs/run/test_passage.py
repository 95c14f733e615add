"""Boards are counted by the way that the barrier was interrupted, not by the number of edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.line_config import ExpectedBoard, Line
from vaoi_station.model import BoardType, CameraHead, RecordingHead, Status, Stitch
from vaoi_station.runs.run.passage import limit_of, measure_passage, way_by_encoder, way_of

LIMIT_MM = 65.5
"""That of a board of 55 mm."""


def boards(*spans_mm: tuple[float, float | None], end_mm: float = 200.0) -> int:
    return measure_passage(spans_mm, end_mm, lambda s: s, LIMIT_MM).boards


@pytest.mark.parametrize(
    ("spans_mm", "count"),
    [
        ([(0, 55)], 1),
        ([(0, 20), (30, 55)], 1),  # a cut-out
        ([(0, 10), (12, 20), (22, 30), (40, 64)], 1),
        ([(0, 55), (95, 150)], 2),
        ([(0, 55), (56, 111)], 2),  # 1 mm apart
        ([(0, 110)], 2),  # they touch
        ([(0, 20), (30, 110)], 2),  # a board with a cut-out and another that touches it
        ([(0, 165)], 3),
        ([(0, 55), (95, 150), (190, 245)], 3),
        ([(0, 55), (95, 120), (130, 150)], 2),  # the second has a cut-out
        ([(0, 55), (95, None)], 2),  # the run ended while the second was in the barrier
        ([(0, None)], 1),  # stuck for 200 mm, or too long
        ([(0, 20), (30, None)], 1),
    ],
)
def test_boards_of_55_mm(spans_mm: list[tuple[float, float | None]], count: int) -> None:
    assert boards(*spans_mm) == count


def test_lengths_gaps_and_leading_edges_are_reported() -> None:
    passage = measure_passage(((-0.3, 0.25), (0.65, 1.2)), 1.0, lambda s: 100 * s, LIMIT_MM)
    assert passage.lengths_mm == pytest.approx((55, 55))
    assert passage.gaps_mm == pytest.approx((40,))
    assert passage.leading_s == (-0.3, 0.65)


def line(**more: Any) -> Line:
    return Line(
        conveyor_mm_s=(0.0, 100.0), barrier_mm=0, start_delay_s=0, trigger_period_s=0.1, tail_s=0.48,
        longest_board_mm=80, **{"expected_board": ExpectedBoard()} | more,
    )  # fmt: skip


def stitch(*ways_mm: float, turned: bool = False) -> Stitch:
    cad = [[0, 1, 0], [1, 0, 0], [0, 0, 1.0]] if turned else [[1, 0, 0], [0, -1, 0], [0, 0, 1.0]]
    return Stitch(
        method="auto",
        image_matrices=(tuple(np.eye(3) for _ in ways_mm),),
        cad_matrix=np.array(cad),
        row_motion=tuple(np.array([[1, 0, 0], [0, 1, way], [0, 0, 1.0]]) for way in ways_mm),
        status=Status.OK,
    )


def test_the_limit_is_the_side_along_the_motion_and_the_longer_one_while_it_is_unknown(board_type: BoardType) -> None:
    """The board has 40 mm × 30 mm."""
    assert limit_of(board_type, line(), None) == pytest.approx(30 * 1.1 + 5), "the rotation is the expected one"
    turned = ExpectedBoard.model_validate({"rotation_deg": 90})
    assert limit_of(board_type, line(expected_board=turned), None) == pytest.approx(40 * 1.1 + 5)
    assert limit_of(board_type, line(), stitch(0.0)) == pytest.approx(30 * 1.1 + 5)
    assert limit_of(board_type, line(), stitch(0.0, turned=True)) == pytest.approx(40 * 1.1 + 5)
    assert limit_of(board_type, line(carrier_mm=100.0), None) == pytest.approx(115)


def test_the_way_follows_the_measured_motion_of_a_belt_that_stops() -> None:
    times_s = np.array([0.0, 0.1, 0.2, 0.3])
    way = way_of(line(), stitch(0.0, 10.0, 10.0, 12.0), times_s)
    assert [way(t) for t in (0.05, 0.15, 0.25)] == pytest.approx([5.0, 10.0, 11.0])
    assert way(-0.1) == pytest.approx(-4.0), "before the first row as fast as on average"
    assert way(0.4) == pytest.approx(16.0)
    assert way_of(line(), None, times_s)(0.25) == pytest.approx(25.0)


def test_the_encoder_gives_the_way_of_a_belt_that_stops() -> None:
    """The belt stood for 1 s before row 0 and for 1 s between rows 1 and 2; between them it moved at half its speed."""
    head = RecordingHead(
        format="vaoi-recording", version=1, cameras=(CameraHead(width=64, height=64, exposure_us=100),), rows=3,
        trigger_period_s=0.1, conveyor_mm_s=(0.0, 100.0), trigger_times_s=(0.0, 0.2, 1.3), belt_mm=(0.0, 10.0, 20.0),
    )  # fmt: skip
    delayed = line().model_copy(update={"start_delay_s": 0.3})
    way = way_by_encoder(delayed, head, -1.3)
    assert [way(t) for t in (-1.3, 0.0, 0.1, 0.2, 1.3)] == pytest.approx([-30.0, 0.0, 5.0, 10.0, 20.0])
    assert way(-1.4) == pytest.approx(-40.0)
    assert [way(t) for t in (1.35, 9.0)] == pytest.approx([25.0, 30.0]), "the next row was not due"
    late = way_by_encoder(delayed, head, 0.1)
    assert late(0.1) == pytest.approx(5.0), "the report of the first edge was lost"
