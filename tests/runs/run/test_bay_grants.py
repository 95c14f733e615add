"""No bay reaches the cameras with pixels of an earlier board, and the coordinator never waits for that."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.acquisition.process.messages import Command, Disarm, Grant, Shutdown
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.errors import GoneError
from vaoi_station.runs.run.bay_grants import BayGrants
from vaoi_station.runs.run.leases import Leases
from vaoi_station.runs.run.memory import Memory

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
