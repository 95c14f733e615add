"""What cameras do between two boards."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest

from tests.acquisition.process.test_session import ScriptedDevice, SessionBench, session_bench
from tests.gige.sequencer import FRAME_START, Sequencer, SequencerSet
from vaoi_station.acquisition.cameras.interface import Arrival, CameraExposure, StatedExposure
from vaoi_station.acquisition.controller.interface import BarrierBlocked, BeltPacing, PulseFired, RunEnded
from vaoi_station.acquisition.process.between_boards import UNREPORTED_S, SequenceStart
from vaoi_station.acquisition.process.messages import (
    BoardMissed,
    FireTrial,
    Grant,
    RunFinished,
    TrialFailed,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import ProgramRow, Verdict

STEPS_US = (300, 100, 50)
START_S, PERIOD_S = 0.3, 0.1


class Sequenced(ScriptedDevice):
    """A camera with the sequencer of the test camera, set to `STEPS_US`."""

    def __init__(self) -> None:
        super().__init__()
        self.sequencer = Sequencer()
        for n, exposure_us in enumerate(STEPS_US):
            self.sequencer.sets[n] = SequencerSet(exposure_us, 0, (n + 1) % len(STEPS_US), FRAME_START)
        self.rewind()

    def rewind(self) -> None:
        modes: dict[str, float] = {"SequencerMode": 1, "SequencerConfigurationMode": 0, "SequencerSetSelector": 0}
        self.sequencer.write("SequencerMode", modes.__getitem__, modes.__setitem__)

    def expose(self) -> StatedExposure:
        active = self.sequencer.active
        assert active is not None
        self.sequencer.advance()
        return StatedExposure(*active)


class Line:
    """A session of two cameras with sequencers. Pulses expose when they are fired, and are reported later."""

    def __init__(self, bench: SessionBench) -> None:
        self.session, self.bench, self._number = bench.session, bench, 0
        self.cameras: list[Any] = bench.cameras
        self._stated: dict[tuple[int, float], StatedExposure] = {}
        for n in range(3):
            self.session.grant(Grant(f"run {n}", n))
        rows = tuple(ProgramRow("", (us, us), (0.0, 0.0)) for us in STEPS_US)
        plan = replace(bench.plan, program=rows, lights=("",), start_delay_s=START_S, period_s=PERIOD_S)
        self.session.arm(plan)

    def event(self, event: Any, now_s: float | None = None) -> None:
        """Let the main loop handle an event, with an inbox that is empty behind it."""
        now_s = event.time_s if now_s is None else now_s
        self.session.handle_event(event, now_s)
        self.session.rewind_sequences(now_s)

    def fire(self, at_s: float) -> None:
        """Fire a pulse: the cameras expose, whatever the station knows of it."""
        for n, camera in enumerate(self.cameras):
            self._stated[n, at_s] = camera.expose()

    def report(self, at_s: float, row: int, now_s: float | None = None) -> None:
        self.event(PulseFired(0, at_s, row), now_s)

    def deliver(self, at_s: float, cameras: tuple[int, ...] = (0, 1)) -> None:
        """Deliver the frames of a pulse."""
        for n in cameras:
            self._number += 1
            slot, stated = self.cameras[n].slots.pop(0), self._stated[n, at_s]
            frame_id = 1 + round(at_s * 10)
            arrival = Arrival(n, slot.number, True, frame_id, at_s, at_s + 0.01, stated=stated)
            self.session.handle_arrival(arrival, at_s + 0.01, at_s + 0.01)
            self.session.rewind_sequences(at_s + 0.01)

    def row(self, at_s: float, row: int, cameras: tuple[int, ...] = (0, 1)) -> None:
        self.fire(at_s)
        self.report(at_s, row)
        self.deliver(at_s, cameras)

    def exposures(self) -> list[dict[int, bool]]:
        """Return for every finished run, which rows of camera 0 are proven."""
        runs = self.bench.of(RunFinished)
        return [{f.row: f.usable for f in run.frames if f.camera == 0} for run in runs]


@pytest.fixture
def line(make_config: Callable[..., StationConfig], monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    with sequenced_bench(make_config(), monkeypatch) as bench:
        yield Line(bench)


@contextmanager
def sequenced_bench(config: StationConfig, monkeypatch: pytest.MonkeyPatch) -> Iterator[SessionBench]:
    monkeypatch.setattr("tests.acquisition.process.test_session.ScriptedDevice", Sequenced)
    with session_bench(config) as bench:
        yield bench


def test_every_board_begins_with_the_first_step(line: Line) -> None:
    for start_s in (10.0, 12.0):
        line.event(BarrierBlocked(0, start_s - START_S))
        for row in range(4):
            line.row(start_s + row * PERIOD_S, row)
        line.event(RunEnded(0, start_s + 0.35, 4, "clear"))
    assert line.exposures() == [dict.fromkeys(range(4), True)] * 2


def test_a_late_report_of_the_barrier_stops_no_camera_during_the_board(line: Line) -> None:
    """A frame of the board before is awaited. Its six rows have led the sequencers round to the first step."""
    line.event(BarrierBlocked(0, 10.0 - START_S))
    for row in range(6):
        line.row(10.0 + row * PERIOD_S, row, (0,) if row == 5 else (0, 1))
    line.event(RunEnded(0, 10.55, 6, "clear"))
    line.fire(10.9)
    line.fire(11.0)
    line.event(BarrierBlocked(0, 10.6), 11.05)
    line.report(10.9, 0, 11.05)
    line.report(11.0, 1, 11.05)
    line.deliver(10.9)
    line.deliver(11.0)
    line.row(11.1, 2)
    line.event(RunEnded(0, 11.15, 3, "clear"))
    line.session.tick(13.0)
    assert line.exposures() == [dict.fromkeys(range(6), True), {0: True, 1: True, 2: True}]


def test_no_camera_is_stopped_while_a_frame_is_awaited_unless_the_next_board_comes(line: Line) -> None:
    for row in range(2):
        line.row(10.0 + row * PERIOD_S, row, (0,) if row == 1 else (0, 1))
    line.event(RunEnded(0, 10.15, 2, "clear"))
    active = [camera.sequencer.active[0] for camera in line.cameras]
    assert active == [STEPS_US[2]] * 2, "camera 1 may still send the frame of row 1"
    line.event(BarrierBlocked(0, 10.3))
    assert [camera.sequencer.active[0] for camera in line.cameras] == [STEPS_US[0]] * 2
    line.row(10.6, 0)
    line.event(RunEnded(0, 10.65, 1, "clear"))
    line.deliver(10.1, (1,))
    assert sorted(map(str, line.exposures())) == ["{0: True, 1: True}", "{0: True}"]


class Slow:
    """A camera that needs `took_s`, by a clock that only it moves, to begin anew."""

    def __init__(self, clock: list[float], took_s: float = 0.03) -> None:
        self._clock, self.rewound, self.took_s = clock, 0, took_s

    def rewind(self) -> None:
        self._clock[0] += self.took_s
        self.rewound += 1


def test_a_rewind_that_would_not_end_before_the_first_pulse_is_left_out_and_logged(
    line: Line, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock = [0.0]
    monkeypatch.setattr("vaoi_station.acquisition.process.between_boards.time.monotonic", lambda: clock[0])
    cameras = [Slow(clock), Slow(clock)]
    sent: list[Any] = []
    start = SequenceStart(cameras, lambda s: s, sent.append)  # type: ignore[arg-type]  # it uses no more of a camera
    plan = replace(line.bench.plan, start_delay_s=0.1, period_s=0.1)
    start.rewind_all()
    start.follow(PulseFired(0, 1.0, 0), plan)
    start.follow(RunEnded(0, 1.1, 1, "clear"), plan)
    start.follow(BarrierBlocked(0, 2.0), plan)
    start.rewind(2.04)
    assert [camera.rewound for camera in cameras] == [2, 1], "at 2.07 s, 30 ms remain to the first pulse"
    with caplog.at_level(logging.WARNING):
        start.follow(PulseFired(0, 2.1, 0), plan)
    assert "before the sequence of exposures had begun anew in camera 1" in caplog.text
    assert [trouble.code for trouble in sent] == ["sequence-late"]
    fast = replace(plan, belt=BeltPacing(20.0, 400, 200, 400, 0.07))
    start.follow(RunEnded(0, 2.2, 1, "clear"), fast)
    start.follow(BarrierBlocked(0, 3.0), fast)
    assert not start.is_due(3.071), "a fast belt brings the first row after 0.07 s"


BRIGHT = (CameraExposure((900.0,), 6.0), CameraExposure((250.0,), 0.0))
TRIAL = FireTrial(Grant("trial-1", 0), BRIGHT, "ring", 80.0)


@pytest.fixture
def bench(make_config: Callable[..., StationConfig]) -> Iterator[SessionBench]:
    with session_bench(make_config()) as bench:
        yield bench


def frames_of(bench: SessionBench, at_s: float) -> None:
    bench.pulse(at_s, 0)
    bench.session.handle_event(RunEnded(0, at_s, 1, "single"), at_s)
    for n, camera in enumerate(bench.cameras):
        slot = camera.slots.pop(0)
        bench.session.handle_arrival(Arrival(n, slot.number, True, 1, at_s, at_s + 0.01), at_s + 0.01, at_s + 0.01)
    bench.session.tick(at_s + 1.0)


def test_a_camera_that_refuses_leaves_no_camera_with_settings_on_trial(bench: SessionBench) -> None:
    own = (250.0, 0.0)
    bench.cameras[1].refused = [(900.0, 6.0)]
    swapped = replace(TRIAL, exposures=(TRIAL.exposures[0], CameraExposure((900.0,), 6.0)))
    with pytest.raises(DeviceError, match="the camera refuses 900"):
        bench.session.fire_trial(swapped, 1.0)
    assert (bench.controller.fired, bench.session.trial.is_under_way) == (0, False)
    assert [camera.exposures[-1] for camera in bench.cameras] == [own, own]


def test_a_camera_that_was_going_away_gets_the_settings_of_the_station_when_it_is_back(bench: SessionBench) -> None:
    own = (250.0, 0.0)
    bench.session.fire_trial(TRIAL, 1.0)
    frames_of(bench, 1.0)
    bench.cameras[0].refused = [own]
    with pytest.raises(DeviceError, match="the camera refuses 250"):
        bench.session.trial.restore()
    assert [len(camera.exposures) for camera in bench.cameras] == [1, 2], "the other one is set back"
    bench.cameras[0].refused = []
    bench.session.trial.camera_back()
    bench.session.trial.camera_back()
    assert [camera.exposures[1:] for camera in bench.cameras] == [[own], [own, own]], "once"


@pytest.mark.parametrize("late", [False, True])
def test_the_trial_after_a_lost_report_works(bench: SessionBench, late: bool) -> None:
    bench.session.fire_trial(TRIAL, 1.0)
    bench.session.tick(1.0 + UNREPORTED_S)
    bench.session.fire_trial(replace(TRIAL, grant=Grant("trial-2", 1)), 4.0)
    if late:
        bench.pulse(1.0, 0)
        bench.session.handle_event(RunEnded(0, 1.0, 1, "single"), 4.0)
    # The controller's clock may be wrong by its bound, so that the pulse seems to come before its command.
    frames_of(bench, 4.0 - 0.001)
    assert [failed.run for failed in bench.of(TrialFailed)] == ["trial-1"]
    [finished] = bench.of(RunFinished)
    assert (finished.run, [f.verdict for f in finished.frames]) == ("trial-2", [Verdict.OK, Verdict.OK])
    assert bench.of(BoardMissed) == []
