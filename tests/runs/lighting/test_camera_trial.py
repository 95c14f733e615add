"""A trial of a camera: it needs a disarmed line and memory to spare, and ends by time, by arming, or on request."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.process import messages
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.runs.lighting.trials import TRIAL_S, CameraTrial, TrialShot
from vaoi_station.runs.run.memory import Memory
from vaoi_station.runs.states.tables import StationState

WANTED = messages.FireTrial(messages.Grant("", 0), (CameraExposure((900.0,), 6.0),), "ring", 80.0)


class Bench:
    """A trial on scripted surroundings: commands are noted, state and time are set by the test."""

    def __init__(self, bays: int = 3) -> None:
        self.commands: list[messages.Command] = []
        self.evicted: list[str] = []
        self.state, self.now_s = StationState.IDLE, 100.0
        self.memory = Memory(self.renew, bays, 60.0)
        self.trial = CameraTrial(self, lambda: self.state, self.memory, self.evicted.append, lambda: self.now_s)

    def send(self, command: messages.Command) -> None:
        self.commands.append(command)

    def renew(self, bay: int) -> int:
        return bay

    def fire(self) -> Future[TrialShot]:
        completion: Future[TrialShot] = Future()
        self.trial.fire(WANTED, completion)
        return completion

    def finish(self, run: str) -> None:
        finished: Any = messages.RunFinished(run, 0, None, (), 1.0, "single")  # type: ignore[arg-type]
        assert self.trial.takes(messages.RunStarted(run, 0, 1.0))
        assert self.trial.takes(finished)


def test_a_pulse_has_memory_of_its_own_until_its_frames_were_copied() -> None:
    bench = Bench()
    shot = bench.fire()
    [command] = bench.commands
    assert isinstance(command, messages.FireTrial)
    assert (command.grant.run, command.light, command.on_us) == ("trial-1", "ring", 80.0)
    with pytest.raises(StateError, match="Another pulse is under way"):
        bench.fire()
    assert not bench.trial.takes(messages.RunStarted("a-board", 1, 1.0))
    bench.finish("trial-1")
    assert shot.result(0).run == "trial-1"
    assert bench.memory.has("trial-1")
    bench.trial.release("trial-1")
    assert not bench.memory.has("trial-1")
    bench.fire()
    assert bench.memory.has("trial-2")


def test_the_settings_of_the_station_come_back_after_the_last_pulse_or_on_request() -> None:
    bench = Bench()
    bench.fire()
    bench.now_s += TRIAL_S
    bench.trial.tick()
    assert len(bench.commands) == 1, "not while a pulse is under way"
    bench.finish("trial-1")
    bench.trial.release("trial-1")
    bench.trial.tick()
    bench.trial.tick()
    bench.trial.end()
    assert bench.commands[1:] == [messages.EndTrial()], "once"
    bench.fire()
    bench.trial.end()
    assert bench.commands[-1] == messages.EndTrial()


def test_a_pulse_for_which_no_caller_waits_any_more_frees_its_memory_when_it_ends() -> None:
    bench = Bench()
    for run, ends_first in (("trial-1", False), ("trial-2", True)):
        shot = bench.fire()
        if ends_first:
            bench.finish(run)
        bench.trial.abandon(shot)
        if not ends_first:
            assert bench.memory.has(run), "the cameras may still fill it"
            bench.finish(run)
        assert bench.memory.available() == 3
    bench.now_s += TRIAL_S
    bench.trial.tick()
    assert bench.commands[-1] == messages.EndTrial()
    failed = bench.fire()
    bench.trial.abandon(failed)
    assert bench.trial.takes(messages.TrialFailed("trial-3", messages.Trouble("wrong-state", "no.", "")))
    assert bench.memory.available() == 3
    refused = bench.fire()
    assert bench.trial.takes(messages.TrialFailed("trial-4", messages.Trouble("wrong-state", "no.", "")))
    bench.fire()
    bench.trial.abandon(refused)
    assert bench.memory.has("trial-5"), "it belongs to another caller"


def test_refusals_and_the_end_of_the_process_free_the_memory() -> None:
    bench = Bench()
    for code, kind in (("wrong-state", StateError), ("setting-refused", DeviceError)):
        shot = bench.fire()
        assert bench.trial.takes(
            messages.TrialFailed(f"trial-{len(bench.commands)}", messages.Trouble(code, "no.", "Wait."))
        )
        assert type(shot.exception(0)) is kind
        assert bench.memory.available() == 3
    shot = bench.fire()
    bench.trial.acquisition_ended("the acquisition process ended")
    assert isinstance(shot.exception(0), DeviceError)
    assert bench.memory.available() == 3
