"""The bays of the ring: runs, leases, evictions, and the grants of bays."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.runs.doubles import CountingRing
from vaoi_station.acquisition.process.messages import Command, Disarm, Grant, Shutdown
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.errors import BusyError, GoneError
from vaoi_station.runs.run.memory import BayGrants, Memory


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def memory_of(bays: int, clock: Clock | None = None, lease_s: float = 1e9) -> Memory:
    return Memory(CountingRing().renew, bays, lease_s, clock or Clock())


def finish(memory: Memory, run: str, keep_s: float = 0.0) -> None:
    memory.grant(run)
    for use in ("filming", "stitching", "finished"):
        memory.use(run, use)
    memory.keep(run, Clock.now_s + keep_s)


def test_the_bay_of_a_run_that_ended_by_a_fault_is_free_again() -> None:
    """Its end could not be stored, so it never became finished."""
    memory = memory_of(3)
    for run, use in (("r1", "filming"), ("r2", "stitching")):
        memory.grant(run)
        memory.use(run, use)  # type: ignore[arg-type]
    memory.grant("r3")
    assert memory.reclaim({"r1"}) == ("r2",)
    assert [memory.has(run) for run in ("r1", "r2", "r3")] == [True, False, True], "a grant waits for its board"
    assert memory.reclaim({"r1"}) == ()


def test_a_run_is_not_evicted_before_it_was_announced_and_its_time_has_passed() -> None:
    clock = Clock()
    memory = memory_of(1, clock)
    finish(memory, "r1", keep_s=5.0)
    with pytest.raises(BusyError, match=r"run r1 is kept for 5 s more") as refusal:
        memory.grant("r2")
    assert "Release a run, or wait" in refusal.value.action
    assert memory.kept()
    clock.now_s += 5.0
    assert not memory.kept()
    assert memory.grant("r2").evicted == "r1"
    memory.use("r2", "finished")
    clock.now_s += 1e6
    with pytest.raises(BusyError, match="run r2 is being written to disk"):
        memory.grant("r3")
    memory.keep("r2", clock.now_s)
    assert memory.grant("r3").evicted == "r2"


class Line(RuleBasedStateMachine):
    """Boards come, are finished, held, let go and released in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.memory = memory_of(3)
        self.count = 0
        self.needed: set[str] = set()
        self.finished: list[str] = []
        self.held: set[str] = set()

    @rule()
    def board(self) -> None:
        self.count += 1
        run = f"r{self.count}"
        free = 3 - len(self.needed) - len(self.finished)
        idle = [r for r in self.finished if r not in self.held]
        if free or idle:
            evicted = self.memory.grant(run).evicted
            assert evicted == (None if free else idle[0])
            self.needed.add(run)
            if evicted:
                self.finished.remove(evicted)
        else:
            with pytest.raises(BusyError):
                self.memory.grant(run)

    @precondition(lambda self: self.needed)
    @rule(data=st.data())
    def end(self, data: st.DataObject) -> None:
        run = data.draw(st.sampled_from(sorted(self.needed)))
        self.memory.use(run, "finished")
        self.memory.keep(run, 0.0)
        self.needed.remove(run)
        self.finished.append(run)

    @precondition(lambda self: self.finished)
    @rule(data=st.data(), end=st.booleans())
    def hold(self, data: st.DataObject, end: bool) -> None:
        run = data.draw(st.sampled_from(self.finished))
        if end:
            self.memory.end_lease(run, "tester")
            self.held.discard(run)
        else:
            self.memory.lease(run, "tester", "AOI")
            self.held.add(run)

    @precondition(lambda self: self.finished)
    @rule(data=st.data())
    def release(self, data: st.DataObject) -> None:
        run = data.draw(st.sampled_from(self.finished))
        self.memory.free(run)
        self.finished.remove(run)
        self.held.discard(run)

    @invariant()
    def all_are_where_they_should_be(self) -> None:
        assert {bay.run for bay in self.memory.bays() if bay.run} == self.needed | set(self.finished)


TestLine = Line.TestCase


def test_a_lease_is_renewed_by_its_holder_and_ends_with_its_time() -> None:
    clock = Clock()
    memory = memory_of(1, clock, lease_s=10.0)
    memory.lease("r1", "tester", "inspection")
    clock.now_s += 8
    lease = memory.lease("r1", "tester", "inspection, still")
    clock.now_s += 9
    assert [(le.purpose, le.expires_in_s) for le in memory.leases()] == [("inspection, still", 1.0)]
    clock.now_s += 1
    assert (memory.leases(), memory.remaining_s(lease)) == ((), 0.0)
    assert memory.expire() == (lease,)
    assert memory.expire() == ()


PATIENCE_S = 60.0


class SlowRing:
    """A real ring; each blackening waits until the test allows it."""

    def __init__(self, path: Path) -> None:
        self.ring = Ring.create(path, RingLayout(2, 3, (FrameShape(40, 30, "Mono8"), FrameShape(64, 20, "Mono8"))))
        self.begun, self.allowed = threading.Semaphore(0), threading.Semaphore(0)

    def blacken(self, bay: int) -> None:
        self.begun.release()
        assert self.allowed.acquire(timeout=PATIENCE_S)
        self.ring.blacken(bay)

    def is_black(self, bay: int) -> bool:
        first = self.ring.slot(bay, 0, 0)
        return not any(self.ring.memory(s).any() for s in range(first, first + self.ring.layout.slots_per_bay))

    def film(self) -> None:
        """Fill every slot of every bay."""
        for slot in range(self.ring.layout.slots):
            self.ring.memory(slot)[:] = 7


class Link:
    """Records commands, and whether the bay of a grant is black at that moment."""

    def __init__(self, ring: SlowRing) -> None:
        self._ring = ring
        self.sent: list[Command] = []
        self.black: list[bool] = []
        self.changed = threading.Condition()

    def send(self, command: Command) -> None:
        with self.changed:
            self.sent.append(command)
            if isinstance(command, Grant):
                self.black.append(self._ring.is_black(command.bay))
            self.changed.notify_all()

    def until(self, count: int) -> None:
        with self.changed:
            assert self.changed.wait_for(lambda: len(self.sent) >= count, PATIENCE_S)


@pytest.fixture
def slow(tmp_path: Path) -> Iterator[SlowRing]:
    made = SlowRing(tmp_path / "ring")
    yield made
    made.ring.close()


@pytest.fixture
def link(slow: SlowRing) -> Link:
    return Link(slow)


@pytest.fixture
def grants(slow: SlowRing, link: Link) -> Iterator[BayGrants]:
    made = BayGrants(slow.blacken, link)
    made.start()
    yield made
    slow.allowed.release(9)
    made.stop()


def test_the_caller_goes_on_and_later_commands_wait_until_the_bay_is_black(
    slow: SlowRing, link: Link, grants: BayGrants
) -> None:
    memory = Memory(slow.ring.renew, 2, 60.0)
    slow.film()
    commands: list[Command] = []
    for run in ("r1", "r2"):
        bay = memory.grant(run).bay
        commands += [Grant(run, bay.number), Disarm()]
        assert not slow.is_black(bay.number), "the coordinator's thread has computed nothing"
    for command in commands:
        grants.send(command)
    assert slow.begun.acquire(timeout=PATIENCE_S)
    assert link.sent == []
    slow.allowed.release(2)
    link.until(4)
    assert link.sent == commands
    assert link.black == [True, True]
    grants.send(Shutdown())
    link.until(5)
    assert link.sent[-1] == Shutdown()


def test_readers_of_the_run_before_never_get_its_pixels_for_those_of_the_next(slow: SlowRing) -> None:
    memory = Memory(slow.ring.renew, 1, 60.0)
    before = memory.grant("r1").bay
    slow.film()
    for use in ("filming", "stitching", "finished"):
        memory.use("r1", use)
    memory.keep("r1", 0.0)
    slot = slow.ring.slot(before.number, 0, 0)
    assert slow.ring.snapshot(slot, before.generation).any()
    after = memory.grant("r2").bay
    with pytest.raises(GoneError):
        slow.ring.snapshot(slot, before.generation)
    assert slow.ring.slot_record(slot)[:2] == (after.generation, 0), "the slot table says: empty"


def test_grants_of_a_process_that_has_ended_never_reach_the_next_one(
    slow: SlowRing, link: Link, grants: BayGrants
) -> None:
    grants.send(Grant("r1", 0))
    grants.send(Disarm())
    assert slow.begun.acquire(timeout=PATIENCE_S)
    grants.forget()
    grants.send(Grant("r2", 1))
    slow.allowed.release(2)
    link.until(1)
    assert link.sent == [Grant("r2", 1)]
