"""The magazine: no slot is ever in two hands, and every frame comes to its own run's memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.acquisition.process.slot_queue import Magazine
from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.acquisition.ring.ring_layout import FrameShape, RingLayout


class Holder:
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
    with Ring.create(tmp_path / "m.ring", RingLayout(3, 3, (FrameShape(16, 16, "Mono8"),) * 2)) as ring:
        yield ring


@pytest.fixture
def cameras() -> list[Holder]:
    return [Holder(), Holder()]


@pytest.fixture
def magazine(ring: Ring, cameras: list[Holder]) -> Magazine:
    return Magazine(ring, cameras)  # type: ignore[arg-type]  # it asks no more of a camera


def numbers(camera: Holder) -> list[int]:
    return [s.number for s in camera.slots]


def test_loading_queues_every_slot_of_a_bay_in_the_camera_it_is_for(
    magazine: Magazine, cameras: list[Holder], ring: Ring
) -> None:
    magazine.load(1)
    for n, camera in enumerate(cameras):
        assert numbers(camera) == [ring.slot(1, n, k) for k in range(3)]
    magazine.unload()
    assert [numbers(c) for c in cameras] == [[], []]
    assert magazine.loaded is None


def test_a_slot_still_being_written_is_not_queued_again_before_it_is_back(
    magazine: Magazine, cameras: list[Holder], ring: Ring
) -> None:
    magazine.load(0)
    flying = cameras[0].fill(5)
    magazine.unload()
    magazine.close_run(0)
    magazine.load(0)
    assert flying not in numbers(cameras[0])
    magazine.came_back(flying)
    magazine.recycle(flying)
    assert flying in numbers(cameras[0])
    assert not ring.memory(flying).any()


def test_a_late_frame_is_brought_home_and_the_foreign_slot_given_back(
    magazine: Magazine, cameras: list[Holder], ring: Ring
) -> None:
    magazine.load(0)
    first = cameras[0].fill(1)
    magazine.came_back(first)
    magazine.unload()
    magazine.load(1)
    late = cameras[0].fill(9)
    magazine.came_back(late)
    home = magazine.home(late, 0, 0)
    assert home is not None
    assert ring.layout.place(home)[:2] == (0, 0)
    assert home != first
    assert (ring.memory(home) == 9).all()
    assert not ring.memory(late).any()
    assert sorted(numbers(cameras[0])) == [ring.slot(1, 0, k) for k in range(3)]


def test_a_frame_that_came_in_an_earlier_runs_slot_gets_one_of_its_own_run(
    magazine: Magazine, cameras: list[Holder], ring: Ring
) -> None:
    magazine.load(0)
    early = cameras[1].fill(4)
    magazine.came_back(early)
    magazine.unload()
    magazine.load(1)
    home = magazine.home(early, 1, 1)
    assert home is not None
    assert ring.layout.place(home)[:2] == (1, 1)
    assert home not in numbers(cameras[1])
    assert len(numbers(cameras[1])) == 2


def test_without_room_a_frame_stays_homeless(magazine: Magazine, cameras: list[Holder]) -> None:
    magazine.load(0)
    slot = cameras[0].fill(1)
    magazine.came_back(slot)
    assert magazine.home(slot, 0, 0) == slot
    assert magazine.home(slot, 2, 0) is None


def test_slots_of_a_closed_run_are_left_alone(magazine: Magazine, cameras: list[Holder], ring: Ring) -> None:
    magazine.load(0)
    slot = cameras[0].fill(7)
    magazine.unload()
    magazine.close_run(0)
    magazine.came_back(slot)
    magazine.recycle(slot)
    assert (ring.memory(slot) == 7).all(), "the bay may be somebody else's by now"
