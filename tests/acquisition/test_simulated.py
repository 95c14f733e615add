"""The simulated station: cameras, controller, boards, line, and what does not fit it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import DeviceFault, Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.pairing.evidence import MAX_FRAME_ID
from vaoi_station.acquisition.process.messages import (
    Arm,
    BoardMissed,
    FireOne,
    FrameSettled,
    Health,
    PulseReported,
    RunFinished,
    RunStarted,
    Trouble,
)
from vaoi_station.acquisition.ring import OK
from vaoi_station.acquisition.simulated import (
    FIRST_ID,
    JITTER_S,
    READOUT_S,
    TRANSFER_S,
    SimulatedBoard,
    SimulatedCamera,
    SimulatedController,
    SimulatedLine,
    accept_plan,
    barrier_edges,
    predict_pulses,
    to_bytes,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, InternalError, StateError
from vaoi_station.model import ProgramRow, Verdict
from vaoi_station.simulation import Passage, Twin, calibration_board, read_scenario
from vaoi_station.simulation.scenario import SpeedChange

PIXELS = np.full(64, 200, np.uint8)
CLOCK = DeviceClock(offset_s=3600.0, drift_ppm=40.0)
TIMEOUT_S = 10.0


@pytest.fixture
def arrivals() -> SimpleQueue[Any]:
    return SimpleQueue()


@pytest.fixture
def camera(arrivals: SimpleQueue[Any]) -> Iterator[SimulatedCamera]:
    """Start a camera with 40 empty slots."""
    camera = SimulatedCamera(1, CLOCK, exposure_us=500.0)
    for number in range(40):
        camera.queue(Slot(number, np.zeros(64, np.uint8)))
    camera.start(arrivals)
    yield camera
    camera.close()


def past_s() -> float:
    """Return a pulse time whose transfer is over already, so that its frame arrives at once."""
    return time.monotonic() - 1.0


def test_the_time_stamp_is_the_pulse_on_the_cameras_clock(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = past_s()
    camera.trigger(host_s, PIXELS)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.complete
    assert 0 <= arrival.time_s - CLOCK.device_s(host_s) < 10e-6


def test_a_frame_arrives_after_exposure_read_out_and_transfer(
    camera: SimulatedCamera, arrivals: SimpleQueue[Any]
) -> None:
    host_s = time.monotonic()
    camera.trigger(host_s, PIXELS)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.host_time_s - host_s >= 500e-6 + READOUT_S + TRANSFER_S


def test_ids_wrap_to_1_and_a_lost_frame_is_counted(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    count = MAX_FRAME_ID - FIRST_ID + 3
    start_s = past_s()
    for n in range(count):
        camera.trigger(start_s + n * (JITTER_S + 1e-3), PIXELS, lost=n == 2)
    ids = [arrivals.get(timeout=TIMEOUT_S).frame_id for _ in range(count - 1)]
    expected = [FIRST_ID + n for n in range(MAX_FRAME_ID - FIRST_ID + 1) if n != 2] + [1, 2]
    assert ids == expected
    with pytest.raises(Empty):
        arrivals.get_nowait()


def test_an_exchanged_frame_has_another_time_stamp_and_id(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = past_s()
    camera.trigger(host_s, PIXELS, stamp_error_s=0.1, id_error=1)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.frame_id == FIRST_ID + 1
    assert arrival.time_s - CLOCK.device_s(host_s + 0.1) == pytest.approx(0.0, abs=10e-6)
    camera.trigger(host_s, PIXELS)
    assert arrivals.get(timeout=TIMEOUT_S).frame_id == FIRST_ID + 1, "the counter itself is not changed"


def test_a_share_of_a_frame_is_incomplete(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    camera.trigger(past_s(), PIXELS, share=0.25)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert (arrival.complete, arrival.frame_id, arrival.time_s) == (False, None, None)
    assert "25%" in arrival.fault


def test_a_late_frame_is_delayed(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = time.monotonic()
    camera.trigger(host_s, PIXELS, late_s=0.05)
    assert arrivals.get(timeout=TIMEOUT_S).host_time_s - host_s >= 0.05 + READOUT_S + TRANSFER_S


PLAN = TriggerPlan(start_delay_s=0.01, period_s=0.005, tail_s=0.01, max_rows=50, debounce_s=0.001, lights=("a", "b"))


class Bench:
    """A controller, and a line that records what it is driven to do."""

    def __init__(self) -> None:
        self.clock = DeviceClock(offset_s=1000.0, drift_ppm=50.0)
        self.fired: list[PulseFired] = []
        self.single: list[PulseFired] = []
        self.armed: list[bool] = []
        self.ended = 0
        self.permits: list[Permit | None] = []
        self.events: EventQueue = SimpleQueue()
        self.controller = SimulatedController(self.clock, cast("Any", self))
        self.controller.start(self.events)

    def start(self, _controller: object, _faults: object) -> None:
        pass

    def threads(self) -> tuple[()]:
        return ()

    def close(self) -> None:
        pass

    def accept(self, plan: TriggerPlan) -> TriggerPlan:
        return plan

    def lights(self) -> tuple[str, ...]:
        return ("ring",)

    def counts_at(self, time_s: float) -> int:
        raise InternalError("this line has no encoder")

    def time_of(self, counts: int) -> float:
        raise InternalError("this line has no encoder")

    def fire(self, event: PulseFired) -> None:
        self.fired.append(event)

    def fire_single(self, event: PulseFired) -> None:
        self.single.append(event)

    def set_armed(self, armed: bool) -> None:
        self.armed.append(armed)

    def end_run(self) -> None:
        self.ended += 1

    def permit_board(self, permit: Permit | None) -> None:
        self.permits.append(permit)

    def line_output(self) -> LineOutput | None:
        return LineOutput(bool(self.permits and self.permits[-1]))

    def board(self, length_s: float, lead_s: float = 0.005) -> float:
        """A board that blocks the barrier; the device time at which it does."""
        start_s = self.clock.now_s() + lead_s
        self.controller.schedule_edges([(start_s, True), (start_s + length_s, False)])
        return start_s

    def run(self) -> list[object]:
        """All events up to the end of a run."""
        events: list[object] = [self.events.get(timeout=10)]
        while not isinstance(events[-1], RunEnded):
            events.append(self.events.get(timeout=10))
        return events


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.controller.close()


def test_a_board_is_filmed_at_the_times_of_the_rule(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    start_s = bench.board(0.02)
    events = bench.run()
    pulses = [e for e in events if isinstance(e, PulseFired)]
    assert isinstance(events[0], BarrierBlocked)
    assert events[0].time_s == start_s
    assert [p.time_s for p in pulses] == pytest.approx([start_s + 0.01 + 0.005 * k for k in range(len(pulses))])
    assert [p.light for p in pulses[:3]] == ["a", "b", "a"]
    assert bench.fired == pulses
    assert bench.ended == 1
    assert "1 boards seen" in bench.controller.health()


def test_a_pulse_is_not_fired_before_its_time(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    bench.board(0.01)
    while True:
        event = bench.events.get(timeout=10)
        assert not isinstance(event, PulseFired) or event.time_s <= bench.clock.now_s()
        if isinstance(event, RunEnded):
            return


def test_disarming_ends_the_run_before_it_returns(bench: Bench) -> None:
    bench.controller.arm(replace(PLAN, period_s=60.0))
    bench.board(3600.0)
    while not isinstance(bench.events.get(timeout=10), PulseFired):
        pass
    bench.controller.disarm()
    end = bench.events.get_nowait()
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "disarmed")
    assert bench.armed == [True, False]
    assert bench.ended == 1


def test_edges_from_before_the_arming_belong_to_no_run(bench: Bench) -> None:
    bench.controller.schedule_edges([(bench.clock.now_s() + 0.01, True)])
    bench.controller.arm(PLAN)
    start_s = bench.board(0.01, lead_s=0.03)
    (blocked,) = [e for e in bench.run() if isinstance(e, BarrierBlocked)]
    assert blocked.time_s == start_s


def test_one_pulse_without_a_board_is_a_run_of_one_row(bench: Bench) -> None:
    bench.controller.fire_one()
    pulse, end = bench.events.get_nowait(), bench.events.get_nowait()
    assert bench.single == [pulse]
    assert bench.fired == []
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "single")


def test_an_armed_controller_fires_no_single_pulse(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    with pytest.raises(StateError, match="armed"):
        bench.controller.fire_one()


def test_a_plan_that_cannot_be_carried_out_leaves_it_idle(bench: Bench) -> None:
    with pytest.raises(InputError, match="period_s"):
        bench.controller.arm(replace(PLAN, period_s=0.0))
    assert bench.armed == []
    assert "idle" in bench.controller.health()


def test_its_clock_is_read_within_the_bound(bench: Bench) -> None:
    before_s = time.monotonic()
    reading = bench.controller.read_clock()
    assert before_s <= reading.host_s <= time.monotonic()
    assert abs(bench.clock.host_s(reading.device_s) - reading.host_s) <= reading.bound_s + 1e-6


def test_permits_and_the_output_are_those_of_the_line(bench: Bench) -> None:
    permit = Permit(1, 5.0)
    bench.controller.permit_board(permit)
    assert bench.permits == [permit]
    assert bench.controller.line_output() == LineOutput(True)
    assert bench.controller.is_watching()


BOUNCE = "[[faults.bounces]]\nat_s = 0.001\nduration_s = 0.001\n"
BOARD_PLAN = TriggerPlan(start_delay_s=0.1, period_s=0.05, tail_s=0.12, max_rows=4, debounce_s=0.002)


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
    pulses = predict_pulses([(0.0, False), (1.0, True), (1.1, False)], BOARD_PLAN)
    assert [p.index for p in pulses] == [0, 1, 2]
    assert [p.time_s for p in pulses] == pytest.approx([1.1, 1.15, 1.2])


def test_pulses_end_at_the_largest_number_of_rows() -> None:
    assert len(predict_pulses([(0.0, False), (1.0, True)], BOARD_PLAN)) == BOARD_PLAN.max_rows


def test_an_interruption_shorter_than_the_debounce_fires_no_pulse() -> None:
    assert predict_pulses([(0.0, False), (1.0, True), (1.001, False)], BOARD_PLAN) == []


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


LINE_PLAN = TriggerPlan(
    start_delay_s=0.1, period_s=0.05, tail_s=0.2, max_rows=6, debounce_s=0.001, lights=("ring", "dome")
)
LINE_TIMEOUT_S = 20.0


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
    assert accept_plan(replace(LINE_PLAN, lights=()), LINE_PLAN) == LINE_PLAN
    assert accept_plan(replace(LINE_PLAN, max_rows=3), LINE_PLAN) == replace(LINE_PLAN, max_rows=3)


@pytest.mark.parametrize("key", ["start_delay_s", "period_s", "tail_s", "debounce_s"])
def test_a_plan_with_other_times_is_refused(key: str) -> None:
    changes: dict[str, Any] = {key: 0.5}
    with pytest.raises(InputError, match=rf"{key} is 0\.5, but must be .*, as in the scenario"):
        accept_plan(replace(LINE_PLAN, **changes), LINE_PLAN)


def test_other_lights_are_refused() -> None:
    with pytest.raises(InputError, match="lights"):
        accept_plan(replace(LINE_PLAN, lights=("laser",)), LINE_PLAN)


def test_boards_pass_only_while_armed_and_one_after_another(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    assert bench.controller.passages == []
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=LINE_TIMEOUT_S)
    assert len(bench.controller.passages) == 1, "the next board waits for the end of the run"
    bench.line.end_run()
    assert bench.controller.came.acquire(timeout=LINE_TIMEOUT_S)
    first, second = bench.controller.passages
    assert [blocked for _, blocked in first] == [False, True, False]
    assert first[-1][0] < second[-1][0]


def test_no_more_boards_come_than_configured(make_line: Callable[..., LineBench]) -> None:
    bench = make_line(boards=1)
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=LINE_TIMEOUT_S)
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
    assert came.acquire(timeout=LINE_TIMEOUT_S)
    line.end_run()
    line.permit_board(Permit(1, valid_s + 1.0))
    assert not came.acquire(timeout=0.1), "it is used up"
    line.permit_board(Permit(2, valid_s))
    assert came.acquire(timeout=LINE_TIMEOUT_S)


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
    assert bench.controller.came.acquire(timeout=LINE_TIMEOUT_S)
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
    fault = bench.faults.get(timeout=LINE_TIMEOUT_S)
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
    asked = replace(LINE_PLAN, lights=("low",), program=rows)
    assert accept_plan(asked, LINE_PLAN, ("ring", "low")) == asked
    with pytest.raises(InputError, match=r"program\.0\.light is 'low', but must be a light of the scenario"):
        accept_plan(asked, LINE_PLAN, ("ring",))


def test_boards_are_rendered_for_the_program(make_line: Callable[..., LineBench]) -> None:
    bench = make_line()
    dim = ProgramRow("ring", (25.0, 250.0), (0.0, 0.0))
    bench.line.accept(replace(bench.plan, lights=("ring",), program=(dim,)))
    bench.line.set_armed(True)
    assert bench.controller.came.acquire(timeout=LINE_TIMEOUT_S)
    pulses = predict_pulses(barrier_edges(bench.twin.passage(0)), bench.plan)
    start_s = bench.controller.passages[0][0][0]
    bench.line.fire(replace(pulses[3], time_s=pulses[3].time_s + start_s))
    frames = [camera.exposures[-1][1] for camera in bench.cameras]
    assert frames[0].mean() < 0.3 * frames[1].mean()


Start = Callable[[StationConfig], Any]
Make = Callable[..., StationConfig]


def passage(config: StationConfig, number: int = 0) -> Passage:
    assert config.simulation is not None
    return Twin(read_scenario(config.simulation.scenario)).passage(number)


def test_a_board_is_filmed_row_by_row_as_the_twin_shows_it(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    bench.grant("one", 0)
    bench.arm()
    finished = bench.until(RunFinished)
    truth = passage(bench.config)
    assert finished.run == "one"
    assert finished.reason == "clear"
    assert finished.head.missing == ()
    assert finished.head.trigger_times_s == truth.head().trigger_times_s
    assert finished.head.lights == truth.lights
    assert [(f.camera, f.row) for f in finished.frames] == [(c, r) for c in range(2) for r in range(truth.rows)]
    for frame in finished.frames:
        assert (frame.verdict, frame.cause) == (Verdict.OK, "")
        assert np.array_equal(bench.ring.frame(frame.slot), truth.frame(frame.camera, frame.row))
        assert bench.ring.slot_record(frame.slot)[:3] == (bench.generations[0], OK, frame.row)
        assert abs(frame.pulse_error_us) < 10_000
    assert [p.pulse.index for p in bench.of(PulseReported)] == list(range(truth.rows))
    assert len(bench.of(FrameSettled)) == 2 * truth.rows
    assert len(bench.of(RunStarted)) == 1
    assert finished.last_frame_host_s >= bench.of(RunStarted)[0].host_time_s
    bench.until(Health)
    assert all(c.connected for c in bench.of(Health)[-1].cameras)


def test_boards_back_to_back_go_into_bays_of_their_own(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    bench.arm(runs=3)
    for n in range(3):
        finished = bench.until(RunFinished)
        assert (finished.run, finished.bay) == (f"run {n}", n)
        truth = passage(bench.config, n)
        for frame in finished.frames:
            assert bench.ring.layout.place(frame.slot)[:2] == (n, frame.camera)
            assert np.array_equal(bench.ring.frame(frame.slot), truth.frame(frame.camera, frame.row))


STATION_FAULTS = """
[[faults.lost_frames]]
board = 0
camera = 0
row = 1
[[faults.lost_rows]]
board = 0
row = 3
[[faults.incomplete_frames]]
board = 0
camera = 1
row = 2
share = 0.4
[[faults.late_frames]]
board = 0
camera = 1
row = 4
delay_s = 0.3
"""


def test_every_fault_ends_as_a_verdict_with_its_cause(start: Start, make_config: Make, tiny: str) -> None:
    bench = start(make_config(tiny + STATION_FAULTS))
    bench.arm(runs=2)
    runs = [bench.until(RunFinished) for _ in range(2)]
    first, second = sorted(runs, key=lambda r: r.run)  # the first one waits for its late frames
    verdicts = {(f.camera, f.row): f for f in first.frames if f.verdict is not Verdict.OK}
    assert set(verdicts) == {(0, 1), (0, 3), (1, 3), (1, 2)}
    assert "lost in transfer: the camera counted it" in verdicts[0, 1].cause
    incomplete = verdicts[1, 2]
    truth = passage(bench.config)
    if incomplete.verdict is Verdict.INCOMPLETE:
        pixels, whole = bench.ring.frame(incomplete.slot), truth.frame(1, 2)
        arrived = round(0.4 * pixels.size)
        assert np.array_equal(pixels.flat[:arrived], whole.flat[:arrived])
        assert not pixels.flat[arrived:].any(), "holes are black"
    else:
        assert incomplete.verdict is Verdict.MISSING, "rows 2 and 3 are both possible"
    late = next(f for f in first.frames if (f.camera, f.row) == (1, 4))
    assert late.verdict is Verdict.OK
    for finished, board in ((first, truth), (second, passage(bench.config, 1))):
        for frame in finished.frames:
            if frame.verdict is Verdict.OK:
                assert bench.ring.layout.place(frame.slot)[0] == finished.bay
                assert np.array_equal(bench.ring.frame(frame.slot), board.frame(frame.camera, frame.row))
    assert {f.verdict for f in second.frames} == {Verdict.OK}


TRIGGER = """
[[faults.ignored_triggers]]
board = 0
camera = 0
row = 2
[[faults.extra_frames]]
board = 1
camera = 1
row = 1
after_s = 0.022
[[faults.exchanged_frames]]
board = 2
camera = 1
row = 2
[[faults.free_running]]
board = 3
camera = 0
interval_s = 0.033
"""


def test_trigger_faults_are_found(start: Start, make_config: Make, tiny: str) -> None:
    """Check that board 4 has no finding and the camera without faults is proven in every run."""
    bench = start(make_config(tiny + TRIGGER))
    bench.arm(runs=3)
    runs = []
    for n in range(5):
        runs.append(bench.until(RunFinished))
        if n < 2:
            bench.grant(f"run {n + 3}", runs[-1].bay)
    runs.sort(key=lambda finished: str(finished.run))  # those that wait for a frame finish later
    for finished, faulty in zip(runs, (0, 1, 1, 0, None), strict=True):
        for frame in finished.frames:
            assert (frame.verdict is Verdict.OK and not frame.cause) or frame.camera == faulty
    proofs = [finished.proof for finished in runs]
    named = [{(f.camera, f.row, f.kind) for f in proof.findings} for proof in proofs]
    assert named[0] == {(0, 2, "ignored-trigger")}
    assert named[1] == {(1, 1, "extra-frame")}
    assert named[2] == {(1, 2, "exchanged"), (1, 3, "early")}
    assert named[3] == {(0, None, "runs-freely")}
    assert named[4] == set()
    assert [p.proven for p in proofs] == [True, True, False, False, True]
    for proof in proofs:
        for camera in proof.cameras:
            assert camera.max_residual_us is None or not camera.proven or camera.max_residual_us < 20


def test_a_board_without_memory_is_missed_and_the_next_is_filmed(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    bench.arm()
    missed = bench.until(BoardMissed)
    assert "no memory was free" in missed.reason
    bench.grant("after", 1)
    finished = bench.until(RunFinished)
    assert finished.run == "after"
    boards = len(bench.of(BoardMissed))
    truth = passage(bench.config, boards)
    for frame in finished.frames:
        assert np.array_equal(bench.ring.frame(frame.slot), truth.frame(frame.camera, frame.row))


def test_pulses_without_the_barrier_show_the_calibration_board_at_rest(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    assert bench.config.simulation is not None
    twin = Twin(read_scenario(bench.config.simulation.scenario))
    still = {camera: pixels for camera, _, pixels in calibration_board.frames(twin)}
    for n in range(3):
        bench.grant(f"pulse {n}", n % 2)
        bench.send(FireOne())
        finished = bench.until(RunFinished)
        assert (finished.run, finished.head.rows, finished.reason) == (f"pulse {n}", 1, "single")
        for frame in finished.frames:
            assert (frame.verdict, frame.cause) == (Verdict.OK, "")
            assert np.array_equal(bench.ring.frame(frame.slot), still[frame.camera])
    bench.grant("board", 2)
    bench.arm()
    bench.send(FireOne())
    assert "the station is armed" in bench.until(Trouble).message
    finished = bench.until(RunFinished)
    assert (finished.run, finished.reason) == ("board", "clear")
    for frame in finished.frames:
        assert np.array_equal(bench.ring.frame(frame.slot), passage(bench.config).frame(frame.camera, frame.row))


BOUNCES = """
[[faults.bounces]]
at_s = 0.1
duration_s = 0.002
[[faults.bounces]]
at_s = 0.001
duration_s = 0.001
[[faults.bounces]]
at_s = -0.05
duration_s = 0.002
"""


def test_a_bouncing_barrier_is_one_board_and_frames_show_the_pulses_really_fired(
    start: Start, make_config: Make, tiny: str
) -> None:
    bench = start(make_config(tiny + BOUNCES))
    bench.grant("one", 0)
    bench.arm()
    finished = bench.until(RunFinished)
    assert len(bench.of(RunStarted)) == 1
    assert bench.of(Trouble) == []
    assert finished.head.missing == ()
    truth = passage(bench.config)
    assert finished.head.rows == truth.rows
    shifted_s = 0.002  # the edge counts that lasts, after the bounce at the leading edge
    first = truth.frame_at(0, truth.pulse_times_s[0] + shifted_s, truth.lights[0], 0)
    assert np.array_equal(bench.ring.frame(finished.frames[0].slot), first)


def test_a_stuck_board_ends_at_the_largest_number_of_rows(start: Start, make_config: Make, tiny: str) -> None:
    bench = start(make_config(tiny + "[[faults.stuck]]\nboard = 0\nrow = 1\n"))
    bench.arm(runs=2)
    stuck, following = bench.until(RunFinished), bench.until(RunFinished)
    assert stuck.reason == "max-rows"
    assert stuck.head.rows == bench.config.line.rows_of_longest_board
    assert stuck.head.missing == ()
    assert following.reason == "clear"
    assert following.head.missing == ()


def test_disarming_returns_unused_grants(start: Start, make_config: Make) -> None:
    config = make_config(interval_s=30.0)
    bench = start(config)
    bench.grant("one", 0)
    bench.grant("two", 1)
    bench.arm()
    bench.until(RunFinished)
    unused = bench.disarm().unused
    assert [(g.run, g.bay) for g in unused] == [("two", 1)]
    assert bench.disarm().unused == ()


def test_disarming_while_a_board_passes_films_it_to_its_end(start: Start, make_config: Make, slow: str) -> None:
    bench = start(make_config(slow))
    bench.grant("one", 0)
    bench.arm()
    bench.until(PulseReported)
    bench.disarm()
    (finished,) = bench.of(RunFinished)
    assert finished.reason == "clear"
    assert finished.head.rows == passage(bench.config).rows
    bench.grant("two", 1)
    bench.arm()
    assert bench.until(RunFinished).head.missing == ()


def test_a_plan_that_differs_from_the_scenario_is_refused(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    plan = TriggerPlan.of(bench.config.line)
    for change, key in (
        ({"period_s": 0.2}, "period_s"),
        ({"max_rows": 500}, "max_rows"),
        ({"lights": ("x",)}, "lights"),
    ):
        bench.send(Arm(replace(plan, **change)))
        assert key in bench.until(Trouble).message
    bench.grant("one", 0)
    bench.arm()
    bench.until(RunFinished)


def test_another_plan_is_refused_while_a_board_passes(start: Start, make_config: Make, slow: str) -> None:
    bench = start(make_config(slow))
    plan = TriggerPlan.of(bench.config.line)
    bench.grant("one", 0)
    bench.arm()
    bench.until(PulseReported)
    bench.send(Arm(replace(plan, max_rows=plan.max_rows - 1)))
    assert "passing" in bench.until(Trouble).message
    bench.until(RunFinished)


def test_a_pipe_that_ends_ends_the_process(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    bench.grant("one", 0)
    bench.arm()
    bench.until(PulseReported)
    bench.connection.close()
    bench.thread.join(30)
    assert not bench.thread.is_alive()


def test_a_scenario_of_another_array_is_refused_before_anything_starts(
    start: Callable[..., Any], make_config: Make, tmp_path: Path, tiny: str
) -> None:
    config = make_config()
    (tmp_path / "scenario.toml").write_text(tiny.replace("width_px = 96", "width_px = 80"))
    bench = start(config, ready=False)
    trouble = bench.until(Trouble)
    assert "width_px is 80, but must be 96" in trouble.message
    assert trouble.action
