"""The line in every order of requests and faults: no order is lost, no bay leaks, no caller waits without end."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from hypothesis.strategies import booleans, sampled_from

from tests.needs import LONG
from tests.runs.conftest import ScriptedWorkers, a_board_type, a_calibration, a_config, a_head
from tests.runs.doubles import CountingRing
from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.process import messages
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.model import FrameRecord, Pulse, Verdict
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import line_control
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.line_control import Completion
from vaoi_station.runs.run.order import Order, OrderFactory
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.standing_order import Resumed
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.store import Store

BAYS = 2
PATIENCE_S = 20.0
STEPS_TO_REST = 60
SELDOM = sampled_from((False, False, False, True))


class Process:
    """An acquisition process that obeys one command at a time, as the real one does."""

    def __init__(self) -> None:
        self.commands: deque[messages.Command] = deque()
        self.begin()

    def begin(self) -> None:
        self.commands.clear()
        self.alive = self.armed = self.disarming = False
        self.grants: deque[messages.Grant] = deque()
        self.board: messages.Grant | None = None

    def send(self, command: messages.Command) -> None:
        if self.alive:
            self.commands.append(command)

    def forget(self) -> None:
        self.commands.clear()

    def obey(self, *, refuses: bool = False) -> messages.Report | None:
        """Carry out the next command, and return what is reported; it refuses to arm if `refuses`."""
        command = self.commands.popleft()
        match command:
            case messages.Grant():
                self.grants.append(command)
            case messages.Arm():
                if refuses:
                    return messages.Trouble("camera-lost", "camera c0 is lost", "Check its cable.")
                self.armed = True
                return messages.Armed()
            case messages.Disarm():
                self.disarming = True
                return self.disarmed()
        return None

    def disarmed(self) -> messages.Disarmed | None:
        """Return the report that the line is disarmed, if that was asked for and no board is passing."""
        if not self.disarming or self.board is not None:
            return None
        self.armed = self.disarming = False
        unused = tuple(self.grants)
        self.grants.clear()
        return messages.Disarmed(unused)


@pytest.fixture
def orders(tmp_path: Path, store: Store) -> tuple[Order, Order]:
    """Two orders with different plans, so that a change needs a disarm."""
    config = a_config(tmp_path)
    references = ReferenceStore(config.data / "references", store, a_calibration().cameras(config.heads))
    first = OrderFactory(config, a_calibration(), store, references)(a_board_type(), None, None)
    assert first.plan is not None
    return first, replace(first, plan=replace(first.plan, period_s=0.2))


def test_no_order_is_lost_and_no_bay_leaks(
    tmp_path: Path, store: Store, orders: tuple[Order, Order], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_control, "PACE", BackoffPolicy(first_s=0.0, longest_s=0.0, proven_s=1.0))
    config = a_config(tmp_path, runs=BAYS)

    class LineMachine(RuleBasedStateMachine):
        """The line, with a process that may refuse or die, callers, holders and a person who disarms."""

        @initialize(resumed=sampled_from((True, True, True, False)))
        def begin(self, resumed: bool) -> None:
            events = EventLog(store)
            archive = Archive(store, events)
            watch = CalibrationWatch(store.checks, events, a_calibration(), ["c0", "c1"])
            self.process, self.workers = Process(), ScriptedWorkers(keep=True)
            taken = Resumed(orders[0], None) if resumed else None
            self.core = Core(
                Parts(
                    config, CountingRing().renew, self.process, self.workers, archive, events,
                    RunIds(store.newest_run()), watch, resumed=taken,
                )
            )  # fmt: skip
            self.announced: deque[tuple[str, float]] = deque()
            archive.on_announced = lambda run, until_s: self.announced.append((run, until_s))
            self.waiting: list[Completion] = []
            self.requests: list[tuple[Completion, Order, int | None]] = []
            self.intended = resumed
            """Whether boards are to be filmed: armed without a limit, and not cancelled since."""
            self.held: deque[str] = deque()

        def _report(self, report: messages.Report | None) -> None:
            if report is not None:
                self.core.acquisition_message(report)
            self._note_answers()

        def _note_answers(self) -> None:
            for request in [request for request in self.requests if request[0].done()]:
                self.requests.remove(request)
                completion, _, runs = request
                refusal = completion.exception()
                if refusal is None:
                    self.intended = runs is None
                elif "Arming failed" in str(refusal):
                    # Its order replaced the one before. After the end of the process it stays in force.
                    self.intended = self.intended and "retries automatically" in str(refusal)

        # --- the process

        @precondition(lambda self: not self.process.alive)
        @rule()
        def opens_its_devices(self) -> None:
            self.process.alive = True
            self._report(messages.Ready(2))

        @rule()
        def works(self) -> None:
            """Open the devices if that was not done, and obey all commands."""
            if not self.process.alive:
                self.opens_its_devices()
            while self.process.commands:
                self.obeys(refuses=False)

        @precondition(lambda self: self.process.alive)
        @rule(certain=SELDOM)
        def dies(self, certain: bool) -> None:
            if not certain:
                return
            self.process.begin()
            self.core.acquisition_ended("the acquisition process ended")
            self._note_answers()

        @precondition(lambda self: self.process.commands)
        @rule(refuses=booleans())
        def obeys(self, refuses: bool) -> None:
            self._report(self.process.obey(refuses=refuses))

        @precondition(lambda self: self.core.machine.state == "arming")
        @rule()
        def reports_a_trouble(self) -> None:
            self._report(messages.Trouble("events-lost", "events were lost", "Check its cable."))

        @precondition(lambda self: self.process.alive)
        @rule(lost=booleans())
        def reports_its_cameras(self, lost: bool) -> None:
            cameras = (CameraHealth(True), CameraHealth(not lost, "cable pulled"))
            self._report(messages.Health(cameras, "fine", time.monotonic()))

        @precondition(lambda self: self.process.armed and self.process.board is None)
        @rule()
        def a_board_comes(self) -> None:
            if not self.process.grants:
                self._report(messages.BoardMissed(time.monotonic(), "no memory was granted"))
                return
            self.process.board = grant = self.process.grants.popleft()
            self._report(messages.RunStarted(grant.run, grant.bay, time.monotonic()))
            self._report(messages.PulseReported(grant.run, Pulse(index=0, time_s=100.0)))

        @precondition(lambda self: self.process.board is not None)
        @rule()
        def the_board_leaves(self) -> None:
            grant, self.process.board = self.process.board, None
            assert grant is not None
            missing = tuple((camera, 0) for camera in (0, 1))
            frames = tuple(FrameRecord(camera=c, row=0, verdict=Verdict.MISSING, cause="lost") for c in (0, 1))
            head = a_head(1, missing)
            now_s = time.monotonic()
            self._report(messages.RunFinished(grant.run, grant.bay, head, frames, now_s, "clear"))
            self._report(self.process.disarmed())

        @precondition(lambda self: self.process.armed and self.process.board is None and self.process.grants)
        @rule()
        def a_board_passes_and_is_held(self) -> None:
            self.a_board_comes()
            self.the_board_leaves()
            self.stitches()
            self.holds()

        @precondition(lambda self: self.process.armed and self.process.board is None)
        @rule()
        def boards_pass_and_are_held_until_the_memory_is_full(self) -> None:
            while self.process.armed and self.process.grants:
                self.a_board_passes_and_is_held()
                self.works()

        # --- callers

        @rule(other_plan=booleans(), runs=sampled_from((None, None, None, 1)))
        def arms(self, other_plan: bool, runs: int | None) -> None:
            completion, order = Completion(), orders[other_plan]
            self.requests.append((completion, order, runs))
            self.core.arm(order, runs, completion)
            self._note_answers()

        # Seldom: after it there is no order that could be lost.
        @precondition(lambda self: len(self.waiting) < 2)
        @rule(certain=SELDOM)
        def disarms(self, certain: bool) -> None:
            if not certain:
                return
            completion = Completion()
            self.waiting.append(completion)
            self.intended = False
            self.core.line.disarm(completion)
            self._note_answers()

        @rule()
        def holds(self) -> None:
            for bay in self.core.memory.bays():
                if bay.use == "finished" and bay.run is not None and bay.run not in self.held:
                    self.core.memory.lease(bay.run, "tester", "AOI")
                    self.held.append(bay.run)
                    return

        @precondition(lambda self: self.held)
        @rule()
        def ends_a_hold(self) -> None:
            self.core.end_lease(self.held.popleft(), "tester")

        @rule()
        def stitches(self) -> None:
            self.workers.perform_kept()
            self.workers.keep = True

        @rule()
        def announces(self) -> None:
            # Runs are announced by the thread that stores them: the machine must not depend on its pace.
            store.database.write(lambda _: None).result(PATIENCE_S)
            while self.announced:
                self.core.announced(*self.announced.popleft())

        @rule()
        def ticks(self) -> None:
            self.core.tick()
            self._note_answers()

        # --- what holds always, and when everything has come to rest

        @invariant()
        def an_order_that_was_not_cancelled_is_in_force(self) -> None:
            if hasattr(self, "core"):
                assert not self.intended or self.core.line.orders.order is not None

        @invariant()
        def every_bay_has_a_run_that_needs_it(self) -> None:
            if not hasattr(self, "core"):
                return
            uses = [bay.use for bay in self.core.memory.bays()]
            assert uses.count("granted") <= 1
            assert ("granted" in uses) == self.core.line.has_grant
            used = {b.run for b in self.core.memory.bays() if b.use in ("filming", "stitching")}
            assert used <= self.core.active.keys()

        def teardown(self) -> None:
            if hasattr(self, "core"):
                self._come_to_rest()
                self._at_rest()

        def _come_to_rest(self) -> None:
            """Let the causes end: the process lives and obeys, holds end, results are stored and announced."""
            for _ in range(STEPS_TO_REST):
                self.works()
                self.reports_its_cameras(lost=False)
                if self.process.board is not None:
                    self.the_board_leaves()
                while self.held:
                    self.ends_a_hold()
                self.stitches()
                self.announces()
                self.ticks()
                is_settled = self.core.machine.state == "armed" or not self.core.line.orders.wants_more
                if is_settled and not (self.process.commands or self.core.active):
                    return
            raise AssertionError(f"does not come to rest: {self.core.machine.state}")

        def _at_rest(self) -> None:
            assert self.core.machine.state == ("armed" if self.core.line.orders.wants_more else "idle")
            assert self.process.armed == (self.core.machine.state == "armed")
            assert all(completion.done() for completion in self.waiting)
            assert self.requests == []
            assert self.core.memory.available() == BAYS - self.core.line.has_grant
            self.an_order_that_was_not_cancelled_is_in_force()

    run_state_machine_as_test(
        LineMachine, settings=settings(max_examples=400 if LONG else 80, stateful_step_count=50, deadline=None)
    )
