"""Tests of the prepared boards: barrier edges, predicted pulses, and frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.simulated import SimulatedBoard, barrier_edges, predict_pulses, to_bytes
from vaoi_station.simulation import Twin, read_scenario
from vaoi_station.simulation.scenario import SpeedChange

BOUNCE = "[[faults.bounces]]\nat_s = 0.001\nduration_s = 0.001\n"
PLAN = TriggerPlan(start_delay_s=0.1, period_s=0.05, tail_s=0.12, max_rows=4, debounce_s=0.002)


@pytest.fixture
def make_twin(tmp_path: Path, tiny: str) -> Callable[[str], Twin]:
    """Return a function that makes the tiny twin with faults."""

    def make(faults: str = "") -> Twin:
        (tmp_path / "board.toml").write_text(tiny + faults)
        return Twin(read_scenario(tmp_path / "board.toml"))

    return make


def test_the_barrier_is_clear_then_blocked_then_clear(make_twin: Callable[..., Twin]) -> None:
    passage = make_twin().passage(0)
    assert barrier_edges(passage) == [(0.0, False), (passage.blocked_s, True), (passage.clear_s, False)]


def test_a_bounce_inverts_the_barrier_for_its_duration(make_twin: Callable[..., Twin]) -> None:
    edges = barrier_edges(make_twin(BOUNCE).passage(0))
    assert len(edges) == 5
    assert [time_s for time_s, _ in edges] == sorted(time_s for time_s, _ in edges)
    assert [blocked for _, blocked in edges] == [False, True, False, True, False]
    assert edges[3][0] - edges[2][0] == pytest.approx(0.001)


def test_a_stuck_board_never_clears_the_barrier(make_twin: Callable[..., Twin]) -> None:
    edges = barrier_edges(make_twin("[[faults.stuck]]\nboard = 0\nrow = 1\n").passage(0))
    assert [blocked for _, blocked in edges] == [False, True]


def test_pulses_follow_the_edge_until_the_tail_is_over() -> None:
    pulses = predict_pulses([(0.0, False), (1.0, True), (1.1, False)], PLAN)
    assert [p.index for p in pulses] == [0, 1, 2]
    assert [p.time_s for p in pulses] == pytest.approx([1.1, 1.15, 1.2])


def test_pulses_end_at_the_largest_number_of_rows() -> None:
    assert len(predict_pulses([(0.0, False), (1.0, True)], PLAN)) == PLAN.max_rows


def test_an_interruption_shorter_than_the_debounce_fires_no_pulse() -> None:
    assert predict_pulses([(0.0, False), (1.0, True), (1.001, False)], PLAN) == []


def test_frames_are_rendered_one_by_one_for_the_predicted_pulses(make_twin: Callable[..., Twin]) -> None:
    twin = make_twin()
    passage = twin.passage(0)
    board = SimulatedBoard(passage, TriggerPlan.of(twin.line, twin.scenario.line.lights), 2)
    assert [pulse.time_s for pulse in board.pulses] == pytest.approx(list(passage.pulse_times_s), abs=1e-6)
    rendered = 0
    while not board.ready:
        board.render_one()
        rendered += 1
    assert rendered == 2 * len(board.pulses)
    last = len(board.pulses) - 1
    assert np.array_equal(board.pixels(1, 0), passage.frame(1, 0).reshape(-1).view(np.uint8))
    assert board.pixels(0, last + 3) is board.pixels(0, last), "rows of a stuck board repeat the last one"


@pytest.mark.parametrize(("dtype", "nbytes"), [(np.uint8, 12), (np.uint16, 24)])
def test_a_frame_becomes_its_flat_little_endian_bytes(dtype: type, nbytes: int) -> None:
    image: NDArray[Any] = np.arange(12).astype(dtype).reshape(3, 4)
    flat = to_bytes(image[::-1])
    assert flat.dtype == np.uint8
    assert flat.size == nbytes
    assert np.array_equal(flat.view(dtype).reshape(3, 4), image[::-1])


def test_pulses_follow_the_counts_of_a_belt_that_stops(make_twin: Callable[..., Twin]) -> None:
    """The controller's rule and the twin's own timetable agree, row by row."""
    twin = make_twin()
    line = twin.scenario.line.model_copy(update={"encoder_counts_per_mm": 20.0})
    belt = twin.scenario.belt.model_copy(update={"changes": (SpeedChange(at_s=0.12, for_s=0.3, factor=0.0),)})
    passage = Twin(twin.scenario.model_copy(update={"line": line, "belt": belt})).passage(0)
    pulses = predict_pulses(barrier_edges(passage), TriggerPlan.of(passage.twin.line), passage.encoder)
    assert [p.time_s for p in pulses] == pytest.approx(passage.pulse_times_s, abs=1e-9)
    assert len(pulses) == passage.rows > 2
    assert max(np.diff([p.time_s for p in pulses])) > 0.3
