"""A pulse with settings on trial: its memory is used for nothing else, and arming follows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from tests.acquisition.process.test_session import SessionBench, session_bench
from vaoi_station.acquisition.cameras.interface import Arrival, CameraExposure
from vaoi_station.acquisition.controller.interface import BarrierBlocked, RunEnded
from vaoi_station.acquisition.process.between_boards import UNREPORTED_S
from vaoi_station.acquisition.process.messages import (
    BoardMissed,
    FireTrial,
    Grant,
    RunFinished,
    RunStarted,
    TrialFailed,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.model import Verdict

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


def test_a_trial_sets_the_cameras_and_is_a_run_of_one_row(bench: SessionBench) -> None:
    bench.session.fire_trial(TRIAL, 1.0)
    assert [camera.exposures for camera in bench.cameras] == [[(900.0, 6.0)], [(250.0, 0.0)]]
    assert (bench.controller.fired, bench.session.trial.is_under_way) == (1, True)
    frames_of(bench, 1.0)
    assert [r.run for r in bench.of(RunStarted)] == ["trial-1"]
    [finished] = bench.of(RunFinished)
    assert [f.verdict for f in finished.frames] == [Verdict.OK, Verdict.OK]
    assert not bench.session.trial.is_under_way
    bench.session.trial.restore()
    assert [camera.exposures[-1] for camera in bench.cameras] == [(250.0, 0.0), (250.0, 0.0)]


def test_a_board_after_a_trial_has_its_own_memory_and_exposures(bench: SessionBench) -> None:
    bench.session.fire_trial(TRIAL, 1.0)
    frames_of(bench, 1.0)
    bench.session.grant(Grant("board", 1))
    bench.session.arm(bench.plan)
    assert [camera.exposures[-1] for camera in bench.cameras] == [(250.0, 0.0), (250.0, 0.0)]
    with pytest.raises(StateError, match="the station is armed; a trial would disturb"):
        bench.session.fire_trial(TRIAL, 3.0)
    before = [list(camera.exposures) for camera in bench.cameras]
    bench.session.trial.restore()
    assert [camera.exposures for camera in bench.cameras] == before, "an armed line keeps the exposures of its plan"
    bench.pulse(10.0, 0)
    assert [r.run for r in bench.of(RunStarted)] == ["trial-1", "board"]


def test_what_is_refused_leaves_the_memory_unused(bench: SessionBench) -> None:
    bench.controller.refuses = True
    with pytest.raises(DeviceError, match="the port is gone"):
        bench.session.fire_trial(TRIAL, 1.0)
    assert not bench.session.trial.is_under_way
    assert bench.cameras[0].slots == []
    bench.controller.refuses = False
    bench.session.fire_trial(TRIAL, 2.0)
    with pytest.raises(StateError, match="a pulse is under way"):
        bench.session.fire_trial(TRIAL, 2.1)


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


def test_a_trial_that_comes_while_a_board_passes_leaves_its_passage_as_it_is(bench: SessionBench) -> None:
    bench.session.grant(Grant("board", 1))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 9.0), 9.0)
    with pytest.raises(StateError, match="the station is armed"):
        bench.session.fire_trial(TRIAL, 9.5)
    bench.pulse(10.0, 0)
    assert [r.host_time_s for r in bench.of(RunStarted)] == [9.0]


def test_a_pulse_that_the_controller_does_not_report_is_given_up(bench: SessionBench) -> None:
    bench.session.fire_trial(TRIAL, 1.0)
    assert bench.session.deadline_s(1.1) == 1.0 + UNREPORTED_S
    bench.session.tick(1.0 + UNREPORTED_S)
    [failed] = bench.of(TrialFailed)
    assert (failed.run, failed.why.message) == ("trial-1", "The controller did not report the pulse.")
    assert not bench.session.trial.is_under_way
    bench.pulse(4.0, 0)  # too late: it is no missed board
    bench.session.handle_event(RunEnded(0, 4.0, 1, "single"), 4.0)
    assert bench.of(BoardMissed) == bench.of(RunStarted) == []


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


def test_a_single_pulse_after_a_lost_report_works(bench: SessionBench) -> None:
    bench.session.fire_trial(TRIAL, 1.0)
    bench.session.tick(1.0 + UNREPORTED_S)
    bench.session.grant(Grant("single", 1))
    bench.session.fire_one(4.0)
    frames_of(bench, 4.0)
    assert [finished.run for finished in bench.of(RunFinished)] == ["single"]
