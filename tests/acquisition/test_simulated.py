"""The simulated station: cameras, controller, boards, line, and what does not fit it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.announced import AnnouncedBoards
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BoardOffer,
    Contacts,
    ContactsChanged,
    EventQueue,
    Permit,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.process.messages import (
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
    SimulatedCamera,
    SimulatedController,
)
from vaoi_station.config import StationConfig
from vaoi_station.line_config import Smema
from vaoi_station.model import Verdict
from vaoi_station.simulation import Passage, Twin, calibration_board, read_scenario

CLOCK = DeviceClock(offset_s=3600.0, drift_ppm=40.0)


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


@pytest.fixture
def make_controller(
    make_config: Callable[..., StationConfig],
) -> Iterator[Callable[..., tuple[SimulatedController, TriggerPlan, EventQueue]]]:
    """Return a function that starts a controller with two cameras without slots; it is closed at the end."""
    started: list[SimulatedController] = []

    def make(
        boards: int = 0, interlock: bool = False, smema: Smema | None = None
    ) -> tuple[SimulatedController, TriggerPlan, EventQueue]:
        config, events = make_config(), SimpleQueue[Any]()
        assert config.simulation is not None
        twin = Twin(read_scenario(config.simulation.scenario))
        cameras = tuple(SimulatedCamera(n, CLOCK, 500.0) for n in range(2))
        started.append(SimulatedController(twin, cameras, boards, 0.0, interlock, smema))
        started[0].start(events)
        return started[0], TriggerPlan.of(twin.line), events

    yield make
    for controller in started:
        controller.close()


Make = Callable[..., tuple[SimulatedController, TriggerPlan, EventQueue]]


def passed(events: EventQueue, timeout_s: float = 20.0) -> bool:
    """Wait for the end of a run; return whether one came."""
    try:
        while not isinstance(events.get(timeout=timeout_s), RunEnded):
            pass
    except Empty:
        return False
    return True


def test_a_conveyor_with_an_interlock_lets_one_board_in_for_each_permit(make_controller: Make) -> None:
    controller, plan, events = make_controller(interlock=True)
    controller.arm(plan)
    assert not passed(events, 0.1)
    output = controller.line_output()
    assert output is not None
    assert not output.high
    controller.permit_board(Permit(1, time.monotonic() - 1.0))
    assert not passed(events, 0.1), "it has run out"
    valid_s = time.monotonic() + 1e3
    controller.permit_board(Permit(1, valid_s))
    assert passed(events)
    controller.permit_board(Permit(1, valid_s + 1.0))
    assert not passed(events, 0.1), "it is used up"
    controller.permit_board(Permit(2, valid_s))
    assert passed(events)


def test_the_line_of_the_twin_announces_boards_and_takes_what_is_offered(make_controller: Make) -> None:
    controller, plan, events = make_controller(boards=1, smema=Smema(sides="both"))
    controller.arm(plan)
    announced = AnnouncedBoards(30.0)
    announced.follow(ContactsChanged(0, -100.0, Contacts()))
    while not isinstance(event := events.get(timeout=20.0), BarrierBlocked):
        if isinstance(event, ContactsChanged):
            announced.follow(event)
    announced.follow(event)
    assert announced.take_came() == "announced"
    controller.offer_board(BoardOffer(7, failed=True, until_s=time.monotonic() + 1e3, exit_s=(0.1, 1.0)))
    contacts = controller.contacts()
    assert contacts is not None
    assert contacts.offered_failed
    time.sleep(0.11)
    assert controller.contacts() == Contacts(next_ready=True, taken=7)


Start = Callable[[StationConfig], Any]
Config = Callable[..., StationConfig]


def passage(config: StationConfig, number: int = 0) -> Passage:
    assert config.simulation is not None
    return Twin(read_scenario(config.simulation.scenario)).passage(number)


def test_a_board_is_filmed_row_by_row_as_the_twin_shows_it(start: Start, make_config: Config) -> None:
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


def test_every_fault_ends_as_a_verdict_with_its_cause(start: Start, make_config: Config, tiny: str) -> None:
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


def test_a_board_without_memory_is_missed_and_the_next_is_filmed(start: Start, make_config: Config) -> None:
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


def test_pulses_without_the_barrier_show_the_calibration_board_at_rest(start: Start, make_config: Config) -> None:
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
    start: Start, make_config: Config, tiny: str
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
