"""The ring: frames in shared memory, written by cameras and read in place by other processes.

One process, the station, creates the file and unlinks it. The acquisition process maps it writable; workers and tester
software map it read-only. A bay's **generation** changes when the bay is given to another board. A reader that finds
the same generation before and after it has read pixels knows to which run they belong.
"""

from __future__ import annotations

import contextlib
import mmap
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring import ring_file
from vaoi_station.acquisition.ring.ring_layout import (
    BAY_RECORD,
    CLOSED,
    EMPTY,
    HEADER,
    IN_USE,
    NO_ROW,
    SLOT_RECORD,
    FrameShape,
    RingLayout,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import GoneError, StateError
from vaoi_station.pixel_formats import picture

__all__ = ["Ring", "RingLayout", "remove_leftovers", "ring_path"]

remove_leftovers = ring_file.remove_leftovers


def ring_path(config: StationConfig) -> Path:
    """Return the path of a station's ring."""
    return config.ring.directory / f"vaoi-{config.name}{ring_file.SUFFIX}"


class Ring:
    """The open ring with its frames. The process that called `create` owns the ring; `attach` only maps it."""

    def __init__(self, path: Path, layout: RingLayout, handle: int, *, writable: bool, owner: bool) -> None:
        """Map the open file `handle`. Callers use `create` or `attach` instead of this constructor."""
        self.path = path
        self.layout = layout
        self.writable = writable
        self.lock_note = ""
        """Why the memory could not be locked in RAM; empty if it is locked, and in processes that only map the ring."""
        self._inode = os.fstat(handle).st_ino
        self._owner_pid = os.getpid() if owner else None
        self._handle = handle if owner else None
        """Descriptor that holds the owner's lock on the file; None in processes that only map the ring."""
        self._map: mmap.mmap | None = ring_file.map_file(handle, layout.file_bytes, writable)
        self._bytes: NDArray[np.uint8] = np.frombuffer(self._map, dtype=np.uint8)
        self._header = self._table(0, 1, HEADER)
        self._bays = self._table(layout.bay_table, layout.bays, BAY_RECORD)
        self._slots = self._table(layout.slot_table, layout.slots, SLOT_RECORD)

    @classmethod
    def create(cls, path: Path, layout: RingLayout) -> Ring:
        """Create the file (exclusively, mode 0640), allocate and lock it. If this fails, remove the file again.

        Raises:
            BusyError: there is not enough memory; the message has the sizes.
            StateError: a living process owns the path.
            InputError: the directory is not writable.
        """
        # Rings whose owner has ended are removed first: they occupy memory and perhaps this path.
        remove_leftovers(path.parent)
        handle = ring_file.create_file(path, layout)
        try:
            ring = cls(path, layout, handle, writable=True, owner=True)
        except BaseException:  # also KeyboardInterrupt: remove the file, then raise it again
            path.unlink(missing_ok=True)
            os.close(handle)
            raise
        ring.lock_note = ring_file.lock_in_ram(ring._bytes)
        ring._slots["row"] = NO_ROW
        # This comes last: readers refuse the file in any other state.
        ring._header["state"] = IN_USE
        return ring

    @classmethod
    def attach(cls, path: Path, writable: bool = False) -> Ring:
        """Map a ring that another process owns.

        Raises:
            NotFoundError: there is no such file.
            InputError: the file is no ring, or one of another layout.
            StateError: the ring is being created or closed.
        """
        handle = ring_file.open_existing(path, writable)
        try:
            layout, header = ring_file.read_layout(handle, path)
            if int(header["state"][0]) != IN_USE:
                raise StateError(f"{path}: is being created or closed.", action="Try again when the station is up.")
            return cls(path, layout, handle, writable=writable, owner=False)
        finally:
            os.close(handle)

    @property
    def owned(self) -> bool:
        """Whether this process created the file and must therefore delete it."""
        # A forked child inherits this object, but it must not delete the file of its parent.
        return self._owner_pid == os.getpid()

    @property
    def closed_by_owner(self) -> bool:
        """Whether the owner has closed the ring; the mapped memory stays readable and does not change any more."""
        return int(self._header["state"][0]) == CLOSED

    def slot(self, bay: int, camera: int, k: int) -> int:
        """Return the number of the k-th slot of a camera in a bay."""
        return self.layout.slot(bay, camera, k)

    def memory(self, slot: int) -> NDArray[np.uint8]:
        """Return the bytes of one frame, (nbytes,) uint8; writable if the ring is."""
        start = self.layout.offset(slot)
        return self._bytes[start : start + self._shape(slot).nbytes]

    def frame(self, slot: int) -> NDArray[Any]:
        """Return the picture in a slot: (height, width), or (height, width, 3) for Bayer; uint8 or full-scale uint16.

        Mono8 and Mono16 are views of the ring, writable if the ring is. Other formats are unpacked into a copy.
        """
        shape = self._shape(slot)
        return picture(self.memory(slot), shape.width, shape.height, shape.format)

    def claim(self, bay: int) -> int:
        """Give a bay to a coming run, with all pixels set to zero; return its new generation."""
        generation = self.renew(bay)
        self.blacken(bay)
        return generation

    def renew(self, bay: int) -> int:
        """Raise the generation of a bay, so that readers of its run notice that the bay is given away; return it.

        The pixels are still those of the run before: `blacken` the bay before it is filled again.
        """
        self._require_writable("claim")
        first = self.layout.slot(bay, 0, 0)
        last = first + self.layout.slots_per_bay
        generation = int(self._header["generation"][0]) + 1
        self._header["generation"] = generation
        # The generation changes before the pixels are cleared: a reader checks it after it has copied the pixels.
        self._bays["generation"][bay] = generation
        self._slots[first:last] = (generation, 0, NO_ROW, 0, 0)
        return generation

    def blacken(self, bay: int) -> None:
        """Set all pixels of a bay to zero, so that holes of an incomplete frame never show an earlier board.

        Takes as long as writing the bay once. Call it after `renew`, and before the bay is
        granted to the acquisition process.
        """
        self._require_writable("claim")
        start = self.layout.offset(self.layout.slot(bay, 0, 0))
        end = start + self.layout.slots_per_bay * self.layout.slot_bytes
        # In pieces, so that no other thread ever waits long for the GIL.
        for offset in range(start, end, self.layout.slot_bytes):
            self._bytes[offset : offset + self.layout.slot_bytes] = 0

    def generation(self, bay: int) -> int:
        """Return the generation of a bay; 0 if the bay was never used."""
        self.layout.slot(bay, 0, 0)  # refuses a bay out of range
        return int(self._bays["generation"][bay])

    def check_generation(self, bay: int, generation: int) -> None:
        """Raise GoneError if the bay was given to another board. Call it both before and after reading pixels."""
        now = self.generation(bay)
        if now != generation:
            raise GoneError(
                f"bay {bay} of the ring holds generation {now}, not {generation}: it was given to a later board.",
                action="Hold a run while you use it, or keep a recording of it.",
            )

    def snapshot(self, slot: int, generation: int) -> NDArray[Any]:
        """Return a copy of one frame; raise GoneError if the bay was given to another board meanwhile."""
        bay = self.layout.place(slot)[0]
        self.check_generation(bay, generation)
        pixels = self.frame(slot).copy()
        self.check_generation(bay, generation)
        return pixels

    def clear(self, slot: int) -> None:
        """Set the pixels of a slot to zero, so that it can be filled again in the same generation."""
        self._require_writable("clear")
        self.memory(slot)[:] = 0
        self.write_slot_record(slot, EMPTY, NO_ROW, None)

    def write_slot_record(self, slot: int, state: int, row: int, frame_id: int | None) -> None:
        """Write state, row and frame id of a slot into the slot table, which serves tester software."""
        self._require_writable("write to")
        bay = self.layout.place(slot)[0]
        self._slots[slot] = (self.generation(bay), state, row, frame_id or 0, 0)

    def slot_record(self, slot: int) -> tuple[int, int, int, int]:
        """Return generation, state, row and frame id of a slot from the slot table."""
        self.layout.place(slot)  # refuses a slot out of range
        entry = self._slots[slot]
        return int(entry["generation"]), int(entry["state"]), int(entry["row"]), int(entry["frame_id"])

    def close(self) -> None:
        """Unmap the ring; the owner also unlinks the file. Arrays that still refer to the memory stay valid."""
        if self._map is None:
            return
        if self.owned:
            self._header["state"] = CLOSED
            # The file is deleted only if the path is still this file: another owner may have created one there since.
            with contextlib.suppress(FileNotFoundError):
                if self.path.stat().st_ino == self._inode:
                    self.path.unlink()
        if self._handle is not None:
            os.close(self._handle)
        mapped, self._map = self._map, None
        del self._bytes, self._header, self._bays, self._slots
        # mmap.close() raises BufferError while NumPy views exist. The memory is unmapped when the last view is gone.
        with contextlib.suppress(BufferError):
            mapped.close()

    def __enter__(self) -> Ring:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _shape(self, slot: int) -> FrameShape:
        return self.layout.frames[self.layout.place(slot)[1]]

    def _table(self, offset: int, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        return self._bytes[offset : offset + count * dtype.itemsize].view(dtype)

    def _require_writable(self, verb: str) -> None:
        if not self.writable:
            raise StateError(f"{self.path}: is mapped read-only; only the station may {verb} its memory.")
