"""Boards pass the virtual line."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from tests.rig.host import Host
from tests.rig.known_boards import known_board, passage_of
from vaoi_station.acquisition.controller.protocol import Step
from vaoi_station.errors import DeviceError
from vaoi_station.rig import line as feeder_module
from vaoi_station.rig.camera_process import CameraProcess
from vaoi_station.rig.chip import HZ, Chip, Edge, Pulse
from vaoi_station.rig.line import (
    LINE_READY,
    READY_TIMEOUT_S,
    BoardFeeder,
    BoardPassage,
    FrameFaults,
    VirtualLine,
    lighting_of,
)
from vaoi_station.rig.rendering import FrameRequest, RenderedBoard
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.scenario import (
    LightSection,
)

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


def pulse(channels: tuple[int, ...], on_us: float) -> Pulse:
    return Pulse(0, 0, channels, on_us)


def test_a_camera_whose_exposures_differ_follows_the_width_of_the_trigger() -> None:
    steps = [{"light": "left", "exposure_us": 100.0}, {"light": "left", "exposure_us": 400.0}]
    scenario = Scenario.model_validate(
        {"lights": {"left": LightSection()}, "line": {"lights": ["left"]}, "program": steps}
    )
    lighting = lighting_of(scenario)
    register_us = lighting.exposures_us[0]
    for row, width_us in enumerate((100.0, 400.0)):
        fired = Pulse(0, 0, (0,), 1000.0, width_us)
        assert lighting.brightness(fired, 0, row) == 1.0
        timed, by_width = lighting.brightnesses(fired, 0, row)
        assert timed == pytest.approx(register_us / width_us)
        assert by_width == 1.0
    assert lighting.brightness(Pulse(0, 0, (0,), 1000.0, 200.0), 0, 1) == 0.5


TIMEOUT_S = 20.0


class ScriptedLine:
    """Records what passes; it fails at one board."""

    def __init__(self, fails_at: int | None = None) -> None:
        self.fails_at = fails_at
        self.started: list[int] = []
        self.one_started = threading.Event()

    def start_passage(self, rendered: RenderedBoard) -> BoardPassage:
        if rendered.metadata.board == self.fails_at:
            raise DeviceError("the emulated chip has ended.")
        self.started.append(rendered.metadata.board)
        self.one_started.set()
        return passage_of(rendered)


@pytest.fixture
def short_boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[RenderedBoard]:
    """Three boards of a few milliseconds."""
    monkeypatch.setattr(feeder_module, "FEED_MARGIN_S", 0.0)
    times = {"edges": ((0.0, True), (0.001, False)), "pulses_s": (0.001,), "lights": ("ring",)}
    return [known_board(tmp_path / str(k), k, **times) for k in range(3)]


def feeder_of(
    line: ScriptedLine,
    boards: list[RenderedBoard],
    interval_s: float = 0.0,
    wait_ready: Callable[[float], bool] = lambda _: True,
    wait_permitted: Callable[[float], bool] = lambda _: True,
) -> BoardFeeder:
    return BoardFeeder(cast("VirtualLine", line), boards, interval_s, wait_ready, wait_permitted)


def test_every_board_waits_until_the_station_is_ready(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    waits: list[tuple[float, int]] = []

    def wait_ready(timeout_s: float) -> bool:
        waits.append((timeout_s, len(line.started)))
        return False

    with feeder_of(line, short_boards, wait_ready=wait_ready) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert waits == [(READY_TIMEOUT_S, 0), (READY_TIMEOUT_S, 1), (READY_TIMEOUT_S, 2)]


def test_a_board_is_held_back_until_the_line_is_ready(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    permits, passed = iter((True, False, True)), list[int]()

    def wait_permitted(timeout_s: float) -> bool:
        assert timeout_s == READY_TIMEOUT_S
        passed.append(len(line.started))
        return next(permits)

    with feeder_of(line, short_boards, wait_permitted=wait_permitted) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert passed == [0, 1, 2], "each board waits before it starts"
    assert [passage.held_s is None for passage in feeder.passages] == [False, True, False]
