"""Memory is never taken from who needs it, and goes to the next board from the oldest."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from vaoi_station.errors import BusyError, GoneError
from vaoi_station.runs.run.leases import OWN, Leases
from vaoi_station.runs.run.memory import Memory


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
