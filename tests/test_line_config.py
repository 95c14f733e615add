"""Tests of the table `line`: what follows from speed and lengths, and limits in the wrong order."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from vaoi_station.config import ControllerConfig, conflicts
from vaoi_station.line_config import Hermes, Line, Smema

VALID: dict[str, Any] = {
    "conveyor_mm_s": (0.0, 100.0), "barrier_mm": 0.0, "start_delay_s": 0.1,
    "trigger_period_s": 0.1, "tail_s": 0.2, "longest_board_mm": 50.0,
}  # fmt: skip


ENCODER: dict[str, Any] = {**VALID, "pacing": "encoder", "encoder": {"counts_per_mm": 20.0}}


def test_the_encoder_counts_the_distances_of_the_nominal_speed() -> None:
    line = Line(**ENCODER)
    assert [line.counts(s) for s in (line.start_delay_s, line.trigger_period_s, line.tail_s)] == [200, 200, 400]
    assert line.encoder_places == (198, 200, 398), "a row is fired 1 ms, 2 counts at the nominal speed, after its count"
    assert line.model_copy(update={"start_delay_s": 0.0, "tail_s": 5e-4}).encoder_places == (0, 200, 0)
    assert line.fastest_mm_s == 125.0
    assert line.shortest_period_s == pytest.approx(0.08)
    assert line.row_ways_mm(3) == (0.0, 10.0, 20.0)
    clocked = Line(**VALID, encoder={"counts_per_mm": 20.0})
    assert (clocked.fastest_mm_s, clocked.shortest_period_s, clocked.row_ways_mm(3)) == (100.0, 0.1, None)


@given(st.floats(0.2, 10.0), st.floats(0.1, 900.0), st.floats(0.06, 1.0), st.floats(0.06, 3.0))
@example(1.0, 400.0, 0.014, 0.5)
def test_the_rows_of_the_encoder_cover_the_longest_board(
    per_mm: float, longest_mm: float, period_s: float, tail_s: float
) -> None:
    """Rows 1.4 mm apart are one count of 1 mm apart: a board of 400 mm needs 446 rows, not 319."""
    given_values = {"longest_board_mm": longest_mm, "trigger_period_s": period_s, "tail_s": tail_s}
    line = Line(**ENCODER | given_values | {"start_delay_s": 0.05, "encoder": {"counts_per_mm": per_mm}})
    start, row, tail = (line.counts(s) for s in (line.start_delay_s, line.trigger_period_s, line.tail_s))
    after_board = math.ceil(longest_mm * per_mm) + tail
    rows = line.rows_of_longest_board
    assert start + rows * row > after_board, "the row after the last one is beyond the tail"
    assert rows == 1 or start + (rows - 2) * row < after_board, "and no row is in vain but the last one"


def test_the_distance_of_the_rows_may_replace_the_period() -> None:
    given = {key: value for key, value in ENCODER.items() if key != "trigger_period_s"}
    line = Line(**given | {"encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})
    assert (line.trigger_period_s, line.counts(line.trigger_period_s)) == (0.08, 160)
    with pytest.raises(ValidationError, match=r"trigger_period_s is 0\.1, but encoder\.row_mm 8\.0 is 0\.08 s at 100 "):
        Line(**ENCODER | {"encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})
    with pytest.raises(ValidationError, match="trigger_period_s"):
        Line(**given)
    with pytest.raises(ValidationError, match="conveyor_mm_s"):
        Line(**given | {"conveyor_mm_s": "fast", "encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})


@pytest.mark.parametrize(
    ("encoder", "words"),
    [
        (None, r'pacing is "encoder", but there is no table \[line\.encoder\]'),
        ({"counts_per_mm": 0.04}, r"rows lie 10 mm, 0\.4 counts, apart, but must be 1 … 1073741824"),
        ({"counts_per_mm": 1e9}, r"rows lie 10 mm, 1e\+10 counts, apart, but must be 1 … 1073741824"),
        ({"counts_per_mm": 100.0}, r"12500 counts/s at 125 mm/s, but must be at most 12000 counts/s"),
        ({"counts_per_mm": 20.0, "fastest_mm_s": 90.0}, r"fastest_mm_s is 90, but must be at least the speed .* 100"),
    ],
)
def test_an_encoder_that_cannot_space_the_rows_is_refused(encoder: dict[str, float] | None, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Line(**VALID, pacing="encoder", encoder=encoder)


def test_addresses_of_neighbours_have_the_port_of_the_lane_unless_it_is_given() -> None:
    hermes = Hermes(lane=2, upstream="10.0.0.7", listen="10.0.0.8:7000")
    assert [hermes.address(one) for one in ("10.0.0.7", "10.0.0.8:7000")] == [("10.0.0.7", 50102), ("10.0.0.8", 7000)]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "upstream, listen or tap is missing"),
        ({"tap": True, "upstream": "a"}, "tap excludes upstream and listen"),
        ({"upstream": "a", "listen": "a"}, "the station would be its own neighbour"),
        ({"listen": "a", "supervisor": "b"}, "must end with a port"),
        ({"listen": "a:99999"}, "its port must be from 1 to 65535"),
        ({"listen": "a b"}, "listen"),
        ({"listen": "a", "places": 0}, "places"),
    ],
)
def test_neighbours_that_cannot_be_are_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Hermes(**table)


@pytest.mark.parametrize(("transfer_s", "limit_s"), [(None, 20.0), (20.0, 20.0), (20.1, 20.1)])
def test_a_transfer_may_not_be_longer_than_the_way_to_the_barrier(transfer_s: float | None, limit_s: float) -> None:
    line, hermes = Line(**VALID, transport_s=(0.0, 20.0)), Hermes(listen="a", transfer_s=transfer_s)
    assert hermes.longest_transfer_s(line) == limit_s
    found = [*conflicts((), None, set(), line, hermes)]
    assert [text[:27] for text in found] == (["hermes.transfer_s is 20.1, "] if limit_s > 20 else [])


def test_contacts_need_the_output_line_ready_and_the_next_machine_takes_boards_in_one_way() -> None:
    off, on = ControllerConfig(backend="serial"), ControllerConfig(backend="serial", interlock="on")
    both, hermes = Smema(sides="both"), Hermes(listen="a")

    def found(controller: ControllerConfig, hermes: Hermes | None, smema: Smema) -> list[str]:
        return [text[:15] for text in conflicts((), controller, set(), None, hermes, smema)]

    assert found(on, None, both) == []
    assert found(off, None, both) == ["[smema] needs c"]
    assert found(on, hermes, both) == ['smema.sides = "']
    assert found(on, hermes, Smema(sides="upstream")) == []
    with pytest.raises(ValidationError, match="must begin with the lower limit"):
        Smema(sides="both", exit_s=(2.0, 1.0))
