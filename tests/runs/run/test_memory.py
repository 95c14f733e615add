"""The bays of the ring: runs, leases, evictions, and the grants of bays."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from vaoi_station.acquisition.process.messages import Command, Disarm, Grant, Shutdown
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.errors import BusyError, GoneError
from vaoi_station.runs.run.memory import MAX_HOLDERS, OWN, BayGrants, Leases, Memory


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Claims:
    """Counts generations as the ring does."""

    def __init__(self) -> None:
        self.generation = 0

    def renew(self, bay: int) -> int:
        self.generation += 1
        return self.generation


def memory_of(bays: int, clock: Clock | None = None) -> tuple[Memory, Leases]:
    leases = Leases(1e9)
    return Memory(Claims(), bays, leases, clock or Clock()), leases


def finish(memory: Memory, run: str, keep_s: float = 0.0) -> None:
    memory.grant(run)
    for use in ("filming", "stitching", "finished"):
        memory.use(run, use)
    memory.keep(run, Clock.now_s + keep_s)


def test_the_oldest_finished_run_is_evicted() -> None:
    memory, _ = memory_of(2)
    finish(memory, "r1")
    finish(memory, "r2")
    granted = memory.grant("r3")
    assert granted.evicted == "r1"
    assert granted.bay.generation == 3
    with pytest.raises(GoneError, match="r1 are no longer"):
        memory.bay("r1")
    assert memory.has("r2")


def test_the_bay_of_a_run_that_ended_by_a_fault_is_free_again() -> None:
    """Its end could not be stored, so it never became finished."""
    memory, _ = memory_of(3)
    for run, use in (("r1", "filming"), ("r2", "stitching")):
        memory.grant(run)
        memory.use(run, use)  # type: ignore[arg-type]
    memory.grant("r3")
    assert memory.reclaim({"r1"}) == ("r2",)
    assert [memory.has(run) for run in ("r1", "r2", "r3")] == [True, False, True], "a grant waits for its board"
    assert memory.reclaim({"r1"}) == ()


def test_oldest_means_finished_first_not_begun_first() -> None:
    memory, _ = memory_of(2)
    memory.grant("r1")
    memory.grant("r2")
    memory.use("r2", "finished")
    memory.use("r1", "finished")
    memory.keep("r1", 0.0)
    memory.keep("r2", 0.0)
    assert memory.grant("r3").evicted == "r2"


def test_a_run_is_not_evicted_before_it_was_announced_and_its_time_has_passed() -> None:
    clock = Clock()
    memory, _ = memory_of(1, clock)
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


def test_pictures_that_are_being_made_keep_no_board_waiting() -> None:
    """A caller that may only read could stop the line with them."""
    memory, leases = memory_of(3)
    for run in ("r1", "r2", "r3"):
        finish(memory, run)
    leases.take("r1", f"{OWN}1", "image U1/0")
    leases.take("r2", f"{OWN}2", "image U1/0")
    leases.take("r2", "tester", "probing")
    assert memory.grant("r4").evicted == "r3", "a run that is not read goes first"
    assert not leases.of("r3")
    assert memory.grant("r5").evicted == "r1"
    assert not leases.of("r1")
    assert memory.held()
    with pytest.raises(BusyError, match=r"r2 is held by tester \(probing\)"):
        memory.grant("r6")


def test_holds_that_leave_memory_for_fewer_than_two_boards_are_a_warning() -> None:
    memory, leases = memory_of(3)
    for run in ("r1", "r2"):
        finish(memory, run)
        assert memory.warning() is None
        leases.take(run, "tester", "AOI")
    warning = memory.warning()
    assert warning is not None
    assert warning.code == "memory-short"
    assert "one further board at a time: run r1 is held by tester (AOI); run r2 is held by tester" in warning.message
    leases.end("r1", "tester")
    assert memory.warning() is None


def test_a_full_ring_names_the_holders() -> None:
    memory, leases = memory_of(3)
    finish(memory, "r1")
    leases.take("r1", "tester 3", "AOI")
    memory.grant("r2")
    memory.use("r2", "filming")
    memory.grant("r3")
    with pytest.raises(BusyError, match=r"r1 is held by tester 3 \(AOI\); run r2 is being filmed; run r3 is reserved"):
        memory.grant("r4")
    leases.take("r1", "tester 3", "")
    with pytest.raises(BusyError, match=r"r1 is held by tester 3; run r2 is being filmed"):
        memory.grant("r4")
    leases.end("r1", "tester 3")
    assert memory.grant("r4").evicted == "r1"


def test_the_refusal_distinguishes_held_memory_from_busy_memory() -> None:
    memory, leases = memory_of(1)
    memory.grant("r1")
    memory.use("r1", "stitching")
    leases.take("r1", "tester", "AOI")
    assert not memory.held()
    with pytest.raises(BusyError) as refusal:
        memory.grant("r2")
    assert "Wait until a run is stitched" in refusal.value.action
    memory.use("r1", "finished")
    memory.keep("r1", 0.0)
    assert memory.held()
    with pytest.raises(BusyError) as refusal:
        memory.grant("r2")
    assert "end a hold" in refusal.value.action


def test_freeing_ends_leases() -> None:
    memory, leases = memory_of(2)
    finish(memory, "r1")
    leases.take("r1", "tester", "AOI")
    memory.free("r1")
    memory.free("never was")
    assert leases.all() == ()
    assert [bay.use for bay in memory.bays()] == ["free", "free"]


class Line(RuleBasedStateMachine):
    """Boards come, are finished, held, let go and released in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.memory, self.leases = memory_of(3)
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
            self.leases.end(run, "tester")
            self.held.discard(run)
        else:
            self.leases.take(run, "tester", "AOI")
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


def test_a_lease_holds_until_its_time_is_over() -> None:
    clock = Clock()
    leases = Leases(10.0, clock)
    lease = leases.take("r1", "tester 3", "inspection")
    clock.now_s += 9
    assert leases.of("r1") == (lease,)
    assert leases.remaining_s(lease) == 1.0
    clock.now_s += 1
    assert leases.of("r1") == ()
    assert leases.remaining_s(lease) == 0.0
    assert leases.expire() == (lease,)
    assert leases.expire() == ()


def test_the_same_holder_renews() -> None:
    clock = Clock()
    leases = Leases(10.0, clock)
    leases.take("r1", "tester", "inspection")
    clock.now_s += 8
    leases.take("r1", "tester", "inspection, still")
    clock.now_s += 8
    assert [lease.purpose for lease in leases.of("r1")] == ["inspection, still"]
    assert leases.expire() == ()


def test_each_holder_has_its_own_and_a_release_ends_all() -> None:
    leases = Leases(10.0, Clock())
    leases.take("r2", "a", "x")
    leases.take("r1", "a", "x")
    leases.take("r1", "b", "y")
    assert [(lease.run, lease.holder) for lease in leases.all()] == [("r1", "a"), ("r1", "b"), ("r2", "a")]
    leases.end("r1", "a")
    leases.end("r1", "no holder")
    assert [lease.holder for lease in leases.of("r1")] == ["b"]
    leases.end_all("r1")
    assert [lease.run for lease in leases.all()] == ["r2"]


def test_the_number_of_holders_of_a_run_is_limited() -> None:
    leases = Leases(10.0, Clock())
    for k in range(MAX_HOLDERS):
        leases.take("r1", f"tester {k}", "")
    leases.take("r1", "tester 3", "again")
    with pytest.raises(BusyError, match="has 32 holders, which is the limit: tester 0") as refused:
        leases.take("r1", "one more", "")
    assert refused.value.code == "too-many-holders"
    leases.take("r1", f"{OWN}1", "the station's own are not counted")
    leases.take("r2", "one more", "")
    leases.end("r1", "tester 0")
    leases.take("r1", "one more", "")


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
    made = BayGrants(slow, link)
    made.start()
    yield made
    slow.allowed.release(9)
    made.stop()


def test_the_caller_goes_on_and_later_commands_wait_until_the_bay_is_black(
    slow: SlowRing, link: Link, grants: BayGrants
) -> None:
    memory = Memory(slow.ring, 2, Leases(60.0))
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
    assert link.sent[-1] == Shutdown(), "nothing waits, so nothing is delayed"


def test_readers_of_the_run_before_never_get_its_pixels_for_those_of_the_next(slow: SlowRing) -> None:
    memory = Memory(slow.ring, 1, Leases(60.0))
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
