"""Tests of the simulated line: accepted plans, boards on the belt, and exposures of the cameras."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import Permit, PulseFired, TriggerPlan
from vaoi_station.acquisition.simulated import SimulatedLine, accept_plan, barrier_edges, predict_pulses, to_bytes
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.model import ProgramRow
from vaoi_station.simulation import Twin, calibration_board, read_scenario

PLAN = TriggerPlan(start_delay_s=0.1, period_s=0.05, tail_s=0.2, max_rows=6, debounce_s=0.001, lights=("ring", "dome"))
TIMEOUT_S = 20.0


@dataclass
class ScriptedCamera:
    """A camera that records its exposures."""

    exposures: list[tuple[float, Any, dict[str, Any]]] = field(default_factory=list)

    def brightness(self, _on_us: float | None) -> float:
        return 1.0

    def trigger(self, host_s: float, pixels: Any, **faults: Any) -> None:
        self.exposures.append((host_s, pixels, faults))


@dataclass
class ScriptedController:
    """A controller that records the edges of the boards that pass."""

    passages: list[list[tuple[float, bool]]] = field(default_factory=list)
    came: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))

    def schedule_edges(self, edges: list[tuple[float, bool]]) -> None:
        self.passages.append(edges)
        self.came.release()


@dataclass
class LineBench:
    """A line with scripted neighbours; its controller's clock is the host's."""

    twin: Twin
    plan: TriggerPlan
    line: SimulatedLine
    cameras: tuple[ScriptedCamera, ...]
    controller: ScriptedController
    faults: SimpleQueue[Any]


@pytest.fixture
def make_line(make_config: Callable[..., StationConfig], tiny: str) -> Iterator[Callable[..., LineBench]]:
    """Return a function that starts a line with faults of the scenario; it is closed at the end."""
    started: list[SimulatedLine] = []

    def make(faults: str = "", boards: int = 0, interlock: bool = False) -> LineBench:
        config = make_config(tiny + faults)
        assert config.simulation is not None
        twin = Twin(read_scenario(config.simulation.scenario))
        plan = TriggerPlan.of(twin.line, twin.scenario.line.lights)
        cameras, controller = (ScriptedCamera(), ScriptedCamera()), ScriptedController()
        clock = DeviceClock(0.0, 0.0, origin_s=0.0)
        line = SimulatedLine(
            twin,
            plan,
            cameras,  # type: ignore[arg-type]  # as much as it uses
            clock,
            boards,
            0.0,
            interlock,
        )
        queue: SimpleQueue[Any] = SimpleQueue()
        line.start(controller, queue)  # type: ignore[arg-type]  # it schedules edges only
        started.append(line)
        return LineBench(twin, plan, line, cameras, controller, queue)

    yield make
    for line in started:
        line.close()


def test_the_plan_of_the_scenario_is_completed_with_its_lights() -> None:
    assert accept_plan(replace(PLAN, lights=()), PLAN) == PLAN
    assert accept_plan(replace(PLAN, max_rows=3), PLAN) == replace(PLAN, max_rows=3)


@pytest.mark.parametrize("key", ["start_delay_s", "period_s", "tail_s", "debounce_s"])
def test_a_plan_with_other_times_is_refused(key: str) -> None:
    changes: dict[str, Any] = {key: 0.5}
    with pytest.raises(InputError, match=rf"{key} is 0\.5, but must be .*, as in the scenario"):
        accept_plan(replace(PLAN, **changes), PLAN)


def test_other_lights_are_refused() -> None:
    with pytest.raises(InputError, match="lights"):
        accept_plan(replace(PLAN, lights=("laser",)), PLAN)


def test_boards_pass_only_while_armed_and_one_after_another(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    assert bench.controller.passages == []
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=TIMEOUT_S)
    assert len(bench.controller.passages) == 1, "the next board waits for the end of the run"
    bench.line.end_run()
    assert bench.controller.came.acquire(timeout=TIMEOUT_S)
    first, second = bench.controller.passages
    assert [blocked for _, blocked in first] == [False, True, False]
    assert first[-1][0] < second[-1][0]


def test_no_more_boards_come_than_configured(make_line: Callable[..., LineBench]) -> None:
    bench = make_line(boards=1)
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=TIMEOUT_S)
    bench.line.end_run()
    assert not bench.controller.came.acquire(timeout=0.1)


def test_a_conveyor_with_an_interlock_lets_one_board_in_for_each_permit(make_line: Callable[..., LineBench]) -> None:
    line, came = (bench := make_line(interlock=True)).line, bench.controller.came
    line.set_armed(True)
    assert not came.acquire(timeout=0.1)
    assert line.line_output() is not None
    line.permit_board(Permit(1, time.monotonic() - 1.0))
    assert not came.acquire(timeout=0.1), "it has run out"
    valid_s = time.monotonic() + 1e3
    line.permit_board(Permit(1, valid_s))
    assert came.acquire(timeout=TIMEOUT_S)
    line.end_run()
    line.permit_board(Permit(1, valid_s + 1.0))
    assert not came.acquire(timeout=0.1), "it is used up"
    line.permit_board(Permit(2, valid_s))
    assert came.acquire(timeout=TIMEOUT_S)


FAULTS = """
[[faults.ignored_triggers]]
board = 0
camera = 0
row = 1
[[faults.lost_frames]]
board = 0
camera = 1
row = 1
[[faults.extra_frames]]
board = 0
camera = 1
row = 2
after_s = 0.02
"""


def test_pulses_expose_the_cameras_with_the_faults_of_the_scenario(make_line: Callable[..., LineBench]) -> None:
    bench = make_line(FAULTS)
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=TIMEOUT_S)
    start_s = bench.controller.passages[0][0][0]
    passage = bench.twin.passage(0)
    for row in range(3):
        bench.line.fire(PulseFired(row, start_s + passage.pulse_times_s[row], row, passage.lights[row]))
    first, second = (camera.exposures for camera in bench.cameras)
    assert [host_s - start_s for host_s, *_ in first] == pytest.approx([passage.pulse_times_s[row] for row in (0, 2)])
    assert [faults.get("lost", False) for *_, faults in second] == [False, True, False, False]
    assert second[3][0] - second[2][0] == pytest.approx(0.02)
    assert np.array_equal(first[0][1], to_bytes(passage.frame(0, 0)))
    assert bench.faults.empty()


def test_an_unexpected_pulse_is_reported_as_a_fault(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    bench.line.fire(PulseFired(0, time.monotonic(), 0))
    fault = bench.faults.get(timeout=TIMEOUT_S)
    assert isinstance(fault, DeviceFault)
    assert "when the twin did not expect one" in fault.error.message
    assert all(camera.exposures == [] for camera in bench.cameras)


def test_a_single_pulse_shows_the_calibration_board(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    bench.line.fire_single(PulseFired(0, 17.0, 0))
    frames = {camera: pixels for camera, _, pixels in calibration_board.frames(bench.twin)}
    for n, camera in enumerate(bench.cameras):
        [(host_s, pixels, faults)] = camera.exposures
        assert (host_s, faults) == (17.0, {})
        assert np.array_equal(pixels, to_bytes(frames[n]))


def test_a_program_is_taken_if_the_scenario_has_its_lights() -> None:
    rows = (ProgramRow("low", (100.0,), (0.0,)),)
    asked = replace(PLAN, lights=("low",), program=rows)
    assert accept_plan(asked, PLAN, ("ring", "low")) == asked
    with pytest.raises(InputError, match=r"program\.0\.light is 'low', but must be a light of the scenario"):
        accept_plan(asked, PLAN, ("ring",))


def test_boards_are_rendered_for_the_program(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    dim = ProgramRow("ring", (25.0, 250.0), (0.0, 0.0))
    bench.line.accept(replace(bench.plan, lights=("ring",), program=(dim,)))
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=TIMEOUT_S)
    pulses = predict_pulses(barrier_edges(bench.twin.passage(0)), bench.plan)
    start_s = bench.controller.passages[0][0][0]
    bench.line.fire(replace(pulses[3], time_s=pulses[3].time_s + start_s))
    frames = [camera.exposures[-1][1] for camera in bench.cameras]
    assert frames[0].mean() < 0.3 * frames[1].mean()
