"""Tests of the slot queue: a slot has one holder at a time, and every frame gets into its own run's memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.acquisition.process.slot_queue import SlotQueue
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout


class SlotHolder:
    """A camera that only holds slots."""

    def __init__(self) -> None:
        self.slots: deque[Slot] = deque()

    def queue(self, slot: Slot) -> None:
        assert slot.number not in [s.number for s in self.slots]
        self.slots.append(slot)

    def take_back(self) -> list[int]:
        numbers = [s.number for s in self.slots]
        self.slots.clear()
        return numbers

    def fill(self, value: int) -> int:
        slot = self.slots.popleft()
        slot.memory[:] = value
        return slot.number


@pytest.fixture
def ring(tmp_path: Path) -> Iterator[Ring]:
    with Ring.create(tmp_path / "m.ring", RingLayout(3, 3, (FrameShape(16, 16, "Mono8"),) * 2, 4096)) as ring:
        yield ring


@pytest.fixture
def cameras() -> list[SlotHolder]:
    return [SlotHolder(), SlotHolder()]


@pytest.fixture
def slot_queue(ring: Ring, cameras: list[SlotHolder]) -> SlotQueue:
    return SlotQueue(ring, cameras)  # type: ignore[arg-type]  # the slot queue uses no more of a camera


def numbers(camera: SlotHolder) -> list[int]:
    return [s.number for s in camera.slots]


def test_loading_queues_every_slot_of_a_bay_in_its_camera(
    slot_queue: SlotQueue, cameras: list[SlotHolder], ring: Ring
) -> None:
    slot_queue.load(1)
    for n, camera in enumerate(cameras):
        assert numbers(camera) == [ring.slot(1, n, k) for k in range(3)]
        assert {slot.room for slot in camera.slots} == {4096}
    slot_queue.unload()
    assert [numbers(c) for c in cameras] == [[], []]
    assert slot_queue.loaded is None


def test_a_slot_still_being_written_is_not_queued_before_it_is_returned(
    slot_queue: SlotQueue, cameras: list[SlotHolder], ring: Ring
) -> None:
    slot_queue.load(0)
    flying = cameras[0].fill(5)
    slot_queue.unload()
    slot_queue.close_bay(0)
    slot_queue.load(0)
    assert flying not in numbers(cameras[0])
    slot_queue.mark_returned(flying)
    slot_queue.recycle(flying)
    assert flying in numbers(cameras[0])
    assert not ring.memory(flying).any()


def test_a_late_frame_is_copied_into_its_own_bay_and_the_other_slot_queued_again(
    slot_queue: SlotQueue, cameras: list[SlotHolder], ring: Ring
) -> None:
    slot_queue.load(0)
    first = cameras[0].fill(1)
    slot_queue.mark_returned(first)
    slot_queue.unload()
    slot_queue.load(1)
    late = cameras[0].fill(9)
    slot_queue.mark_returned(late)
    moved = slot_queue.move_to_bay(late, 0, 0)
    assert moved is not None
    assert ring.layout.place(moved)[:2] == (0, 0)
    assert moved != first
    assert (ring.memory(moved) == 9).all()
    assert not ring.memory(late).any()
    assert sorted(numbers(cameras[0])) == [ring.slot(1, 0, k) for k in range(3)]


def test_a_frame_in_a_slot_of_an_earlier_run_is_copied_into_its_own_bay(
    slot_queue: SlotQueue, cameras: list[SlotHolder], ring: Ring
) -> None:
    slot_queue.load(0)
    early = cameras[1].fill(4)
    slot_queue.mark_returned(early)
    slot_queue.unload()
    slot_queue.load(1)
    moved = slot_queue.move_to_bay(early, 1, 1)
    assert moved is not None
    assert ring.layout.place(moved)[:2] == (1, 1)
    assert moved not in numbers(cameras[1])
    assert len(numbers(cameras[1])) == 2
