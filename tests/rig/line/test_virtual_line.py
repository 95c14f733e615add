"""Boards before the real firmware on its emulated chip; the cameras' wires end nowhere."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from tests.rig.host import Host
from vaoi_station.acquisition.controller.protocol import Step
from vaoi_station.errors import DeviceError
from vaoi_station.rig.camera_process import CameraProcess
from vaoi_station.rig.chip import HZ, Chip, Edge
from vaoi_station.rig.line import (
    LINE_READY,
    BoardFeeder,
    BoardPassage,
    FrameFaults,
    VirtualLine,
    lighting_of,
    wall_clock_ns,
)
from vaoi_station.rig.rendering import FrameRequest, RenderedBoard
from vaoi_station.simulation import Scenario

RING_LIGHT = Step(0b0001, 500)
"""250 us in ticks: as long as the exposure."""
PATIENCE_S = 10.0


@dataclass
class Line:
    stage: VirtualLine
    chip: Chip
    host: Host
    rows: list[tuple[int, int]]
    """Board and row, as they were on_row."""
    views: list[FrameRequest]
    """What was asked for that no rendered has."""


@pytest.fixture
def line(small: Scenario, built: Path, tmp_path: Path) -> Iterator[Line]:
    rows: list[tuple[int, int]] = []
    wires = [CameraProcess("127.0.0.2", "A"), CameraProcess("127.0.0.3", "B")]
    frame_faults = FrameFaults(ignored=frozenset({(0, 2, 1)}))
    views: list[FrameRequest] = []
    stage = VirtualLine(
        wires, lighting_of(small), frame_faults, lambda board, row: rows.append((board, row)), views.append
    )
    with Chip(built, tmp_path / "trigger", stage.on_edge, stage.on_chip_reset) as chip:
        stage.attach_chip(chip)
        with Host(chip.terminal) as host:
            yield Line(stage, chip, host, rows, views)


def pass_by(line: Line, rendered: RenderedBoard) -> BoardPassage:
    """Let a board pass, and wait for all its pulses: the chip's clock may lag behind on a loaded machine."""
    passage = line.stage.start_passage(rendered)
    line.host.wait(rendered.duration_s + 0.3)
    deadline_s = time.monotonic() + PATIENCE_S
    while len(passage.fired) < rendered.rows and time.monotonic() < deadline_s:
        line.host.wait(0.1)
    return passage


def test_the_cameras_clock_is_read_without_a_gap_between_two_clocks() -> None:
    """Sixty times, whatever else this computer does: all within what a clock is corrected by meanwhile."""
    now_ns = time.monotonic_ns()
    walls_ns = [wall_clock_ns(now_ns) for _ in range(60)]
    assert max(walls_ns) - min(walls_ns) < 100_000
    assert abs(walls_ns[-1] - (time.time_ns() - time.monotonic_ns() + now_ns)) < 1_000_000_000


def test_every_pulse_comes_when_its_frames_were_rendered_for(
    line: Line, small: Scenario, boards: tuple[RenderedBoard, ...]
) -> None:
    line.host.arm(small, (RING_LIGHT,))
    for board, rendered in enumerate(boards):
        passage = pass_by(line, rendered)
        assert [fired.row for fired in passage.fired] == list(range(rendered.rows))
        assert max(abs(fired.offset_us) for fired in passage.fired) < 1.0
        assert {fired.note for fired in passage.fired} == {""}
        assert all(fired.brightness == [1.0, 1.0] for fired in passage.fired)
        first_s = (passage.fired[0].pulse.host_ns - passage.blocked_ns) * 1e-9
        assert first_s == pytest.approx(small.line.start_delay_s, abs=1e-5)
        assert [row for number, row in line.rows if number == board] == list(range(rendered.rows))
        ignored = {(2, 1)} if board == 0 else set()
        outcomes = {(fired.row, n): outcome for fired in passage.fired for n, outcome in enumerate(fired.outcomes)}
        assert {cell for cell, outcome in outcomes.items() if outcome == "ignored"} == ignored
        assert {outcome for cell, outcome in outcomes.items() if cell not in ignored} == {"dead"}
    assert line.stage.unexpected_pulses == []


def test_light_is_what_the_leds_did(line: Line, small: Scenario, boards: tuple[RenderedBoard, ...]) -> None:
    """Half as long, on another channel, and not at all."""
    line.host.arm(small, (Step(0b0001, 250), Step(0b0010, 500), Step(0, 0), RING_LIGHT))
    passage = pass_by(line, boards[0])
    assert [fired.brightness[0] for fired in passage.fired[:4]] == [pytest.approx(0.5, abs=0.002), 0.0, 0.0, 1.0]
    assert [bool(fired.note) for fired in passage.fired[:4]] == [False, True, False, False]
    assert "LED channels (1,) were lit, not those of 'ring'" in passage.fired[1].note


def test_pulses_at_other_times_are_rendered_on_demand(
    line: Line, small: Scenario, boards: tuple[RenderedBoard, ...]
) -> None:
    """Pulses 1 ms later than the rendered's, and one while nothing passes."""
    late = small.line.model_copy(update={"start_delay_s": small.line.start_delay_s + 0.001})
    line.host.arm(small.model_copy(update={"line": late}), (RING_LIGHT,))
    passage = line.stage.start_passage(boards[0])
    line.host.wait(boards[0].duration_s + 0.3)
    times_s = [t + 0.001 for t in boards[0].metadata.pulses_s]
    fired = [fired for fired in passage.fired if fired.row is None]
    assert len(fired) == len(passage.fired) > 0
    assert {outcome for each in fired for outcome in each.outcomes} == {"late"}
    assert {view.board for view in line.views} == {0}
    assert {view.light for view in line.views} == {"ring"}
    asked_s = sorted(view.time_s for view in line.views)
    assert asked_s == pytest.approx(times_s[: len(asked_s)], abs=1e-6)


def test_after_a_reset_the_barrier_still_follows_the_board(
    line: Line, small: Scenario, boards: tuple[RenderedBoard, ...]
) -> None:
    """The board leaves it at the cycle it would have: the next one is seen."""
    line.host.arm(small, (RING_LIGHT,))
    passage = line.stage.start_passage(boards[0])
    line.host.wait(0.5)
    line.chip.send("reset external")
    line.host.wait(boards[0].duration_s)
    fired = len(passage.fired)
    assert fired < boards[0].rows
    line.host.arm(small, (RING_LIGHT,))
    again = line.stage.start_passage(boards[1])
    line.host.wait(boards[1].duration_s + 0.3)
    assert [pulse.row for pulse in again.fired] == list(range(boards[1].rows))
    assert max(abs(pulse.offset_us) for pulse in again.fired) < 1.0
    assert again.start_cycle - passage.start_cycle > boards[0].duration_s * HZ


def test_a_chip_that_has_ended_ends_the_boards(line: Line, boards: tuple[RenderedBoard, ...]) -> None:
    """The thread that waits for the boards gets the error, and does not wait for ever."""
    os.kill(line.chip.pid, signal.SIGKILL)
    os.waitid(os.P_PID, line.chip.pid, os.WEXITED | os.WNOWAIT)
    with (
        pytest.raises(DeviceError, match="the emulated chip has ended"),
        BoardFeeder(line.stage, boards, 0.1) as feeder,
    ):
        assert feeder.finished.wait(30)
    assert feeder.passages == []


def test_stamps_come_late_from_a_board_on() -> None:
    faults = FrameFaults(late_stamps=((1, 0, 0.02), (2, 0, 0.001), (0, 1, 0.1)))
    assert [faults.stamp_delay_ns(board, 0) for board in range(3)] == [0, 20_000_000, 21_000_000]
    assert faults.stamp_delay_ns(0, 1) == 100_000_000


def test_the_conveyor_is_permitted_by_the_output_of_the_chip(small: Scenario) -> None:
    stage = VirtualLine([], lighting_of(small))
    assert not stage.wait_permitted(0.0)
    stage.on_edge(Edge(10, LINE_READY, True, 625))
    assert stage.wait_permitted(0.0)
    stage.on_edge(Edge(20, LINE_READY, False, 1250))
    assert not stage.wait_permitted(0.0)
    stage.on_edge(Edge(30, LINE_READY, True, 1875))
    stage._chip = cast("Chip", object())
    stage.on_chip_reset()
    assert not stage.wait_permitted(0.0), "a reset lowers all outputs"
