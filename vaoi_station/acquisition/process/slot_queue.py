"""Which slots the cameras hold: loaded before a board comes, taken back after it.

A slot is out from the moment it is queued until it comes back, filled or not. A slot that a camera still
writes to when its run is over stays out, and is not queued again before it has come back.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from vaoi_station.acquisition.cameras.interface import CameraDevice, Slot
from vaoi_station.acquisition.ring.ring import Ring


class Magazine:
    """Moves slots between ring and cameras; used by one thread."""

    def __init__(self, ring: Ring, cameras: Sequence[CameraDevice]) -> None:
        self._ring, self._cameras = ring, cameras
        self._out: set[int] = set()
        self._spare: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        """(bay, camera) → slots taken back unused, while the bay's run is open."""
        self._loaded: int | None = None

    @property
    def loaded(self) -> int | None:
        """The bay whose slots the cameras hold for coming frames."""
        return self._loaded

    def load(self, bay: int) -> None:
        """Queue every slot of a bay."""
        self._loaded = bay
        for camera in range(len(self._cameras)):
            for k in range(self._ring.layout.slots_per_camera):
                slot = self._ring.slot(bay, camera, k)
                if slot not in self._out:
                    self._queue(slot)

    def unload(self) -> None:
        """Take back what was not used; kept for late frames of the same run."""
        self._loaded = None
        for camera in range(len(self._cameras)):
            for slot in self._take_back(camera):
                self._spare[self._ring.layout.place(slot)[0], camera].append(slot)

    def came_back(self, slot: int) -> None:
        """A camera has finished with a slot."""
        self._out.discard(slot)

    def recycle(self, slot: int) -> None:
        """A slot's frame is nobody's: it is blackened, and queued again if its bay is still filled."""
        bay, camera, _ = self._ring.layout.place(slot)
        if bay == self._loaded:
            self._ring.clear(slot)
            self._queue(slot)
        elif (bay, camera) in self._spare:
            self._ring.clear(slot)
            self._spare[bay, camera].append(slot)

    def home(self, slot: int, bay: int, camera: int) -> int | None:
        """Bring a frame into its run's bay, if it came in a slot of another; None if there is no room.

        That happens to late frames only: they find the slots of the next run in the camera.
        """
        if self._ring.layout.place(slot)[0] == bay:
            return slot
        room = self._room(bay, camera)
        if room is not None:
            self._ring.memory(room)[:] = self._ring.memory(slot)
            self.recycle(slot)
        return room

    def close_run(self, bay: int) -> None:
        """A run is finished: its spare slots are nobody's any more."""
        for camera in range(len(self._cameras)):
            self._spare.pop((bay, camera), None)

    def _room(self, bay: int, camera: int) -> int | None:
        if spare := self._spare.get((bay, camera)):
            return spare.pop()
        if bay != self._loaded:
            return None
        queued = self._take_back(camera)
        for slot in queued[:-1]:
            self._queue(slot)
        return queued[-1] if queued else None

    def _queue(self, slot: int) -> None:
        self._out.add(slot)
        camera = self._ring.layout.place(slot)[1]
        self._cameras[camera].queue(Slot(slot, self._ring.memory(slot)))

    def _take_back(self, camera: int) -> list[int]:
        slots = self._cameras[camera].take_back()
        self._out.difference_update(slots)
        return slots
