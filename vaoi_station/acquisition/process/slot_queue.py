"""Track which slots of the ring the cameras hold: from being queued until they are returned, filled or not."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from vaoi_station.acquisition.cameras.interface import CameraDevice, Slot
from vaoi_station.acquisition.ring import Ring


class SlotQueue:
    """Moves slots between the ring and the cameras. Used by one thread only."""

    def __init__(self, ring: Ring, cameras: Sequence[CameraDevice]) -> None:
        self._ring, self._cameras = ring, cameras
        self._held: set[int] = set()
        self._spare: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        """(bay, camera) → slots taken back unused while the bay's run is open."""
        self.loaded: int | None = None
        """The bay whose slots the cameras hold at present."""

    def load(self, bay: int) -> None:
        """Queue every slot of a bay in the cameras, except those to which a camera still writes."""
        self.loaded = bay
        for camera in range(len(self._cameras)):
            for k in range(self._ring.layout.slots_per_camera):
                slot = self._ring.slot(bay, camera, k)
                if slot not in self._held:
                    self._queue(slot)

    def unload(self) -> None:
        """Take back the slots that the cameras have not used. They are kept for late frames of the same run."""
        self.loaded = None
        for camera in range(len(self._cameras)):
            for slot in self._take_back(camera):
                self._spare[self._ring.layout.place(slot)[0], camera].append(slot)

    def mark_returned(self, slot: int) -> None:
        """Record that a camera has delivered a slot, and so no longer holds it."""
        self._held.discard(slot)

    def recycle(self, slot: int) -> None:
        """Clear the slot of an unassigned frame. Queue it again if its bay is still being filled."""
        bay, camera, _ = self._ring.layout.place(slot)
        # The slot is cleared, because missing parts of a later incomplete frame must be black. A bay of a finished run
        # is not touched: it may already belong to the next board.
        if bay == self.loaded:
            self._ring.clear(slot)
            self._queue(slot)
        elif (bay, camera) in self._spare:
            self._ring.clear(slot)
            self._spare[bay, camera].append(slot)

    def move_to_bay(self, slot: int, bay: int, camera: int) -> int | None:
        """Return the slot of a frame in its run's bay, to which a late frame is copied; None if the bay is full."""
        if self._ring.layout.place(slot)[0] == bay:
            return slot
        free = self._free_slot(bay, camera)
        if free is not None:
            self._ring.memory(free)[:] = self._ring.memory(slot)
            self.recycle(slot)
        return free

    def close_bay(self, bay: int) -> None:
        """Forget the unused slots of a finished run."""
        for camera in range(len(self._cameras)):
            self._spare.pop((bay, camera), None)

    def _free_slot(self, bay: int, camera: int) -> int | None:
        if spare := self._spare.get((bay, camera)):
            return spare.pop()
        if bay != self.loaded:
            return None
        # A camera fills its slots in order. So the last slot is taken, and the others are queued again in their order.
        queued = self._take_back(camera)
        for slot in queued[:-1]:
            self._queue(slot)
        return queued[-1] if queued else None

    def _queue(self, slot: int) -> None:
        self._held.add(slot)
        camera = self._ring.layout.place(slot)[1]
        self._cameras[camera].queue(Slot(slot, self._ring.memory(slot), self._ring.layout.room_bytes))

    def _take_back(self, camera: int) -> list[int]:
        slots = self._cameras[camera].take_back()
        self._held.difference_update(slots)
        return slots
