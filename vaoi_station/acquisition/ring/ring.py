"""The ring: frames in shared memory, written by cameras and read in place by everybody else.

One process, the station, makes the file and unlinks it; the acquisition process maps it writable; workers
and tester software map it read-only. A bay's **generation** changes when the bay is given to another
board: who remembers the generation can tell, before and after looking, whose pixels it saw.
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

__all__ = ["Ring", "RingLayout", "ring_path", "sweep"]

sweep = ring_file.sweep


def ring_path(config: StationConfig) -> Path:
    """Where a station keeps its ring, unless told otherwise."""
    return config.ring.directory / f"vaoi-{config.name}{ring_file.SUFFIX}"


class Ring:
    """An open ring; `create` owns the file, `attach` borrows it. Views die with `close`."""

    def __init__(self, path: Path, layout: RingLayout, handle: int, *, writable: bool, owner: bool) -> None:
        self.path = path
        self.layout = layout
        self.writable = writable
        self.lock_note = ""
        """Why the memory could not be locked; empty where it is, and for readers."""
        self._inode = os.fstat(handle).st_ino
        self._owner_pid = os.getpid() if owner else None
        self._handle = handle if owner else None
        """Holds the owner's lock on the file."""
        self._map: mmap.mmap | None = ring_file.map_file(handle, layout.file_bytes, writable)
        self._bytes: NDArray[np.uint8] = np.frombuffer(self._map, dtype=np.uint8)
        self._header = self._table(0, 1, HEADER)
        self._bays = self._table(layout.bay_table, layout.bays, BAY_RECORD)
        self._slots = self._table(layout.slot_table, layout.slots, SLOT_RECORD)

    @classmethod
    def create(cls, path: Path, layout: RingLayout) -> Ring:
        """Make the file (exclusively, mode 0640), allocate and lock it; leftovers of dead owners are swept first.

        Raises BusyError with the sizes if the memory is not there, StateError if a living process owns the
        path; in both cases nothing is left behind.
        """
        sweep(path.parent)
        handle = ring_file.create_file(path, layout)
        try:
            ring = cls(path, layout, handle, writable=True, owner=True)
        except BaseException:  # whatever ended it, tidy up; it is raised again
            path.unlink(missing_ok=True)
            os.close(handle)
            raise
        ring.lock_note = ring_file.lock(ring._bytes)
        ring._slots["row"] = NO_ROW
        ring._header["state"] = IN_USE
        return ring

    @classmethod
    def attach(cls, path: Path, writable: bool = False) -> Ring:
        """Map a ring somebody else owns; NotFoundError, or InputError for a foreign file or layout."""
        handle = ring_file.open_existing(path, writable)
        try:
            layout, header = ring_file.read_layout(handle, path)
            if int(header["state"][0]) != IN_USE:
                raise StateError(f"{path}: is being made or taken down.", action="Try again when the station is up.")
            return cls(path, layout, handle, writable=writable, owner=False)
        finally:
            os.close(handle)

    @property
    def owned(self) -> bool:
        """Whether this process made the file and will unlink it."""
        return self._owner_pid == os.getpid()

    @property
    def closed_by_owner(self) -> bool:
        """Whether the owner has taken the ring down; what is mapped stays readable but will not change."""
        return int(self._header["state"][0]) == CLOSED

    def slot(self, bay: int, camera: int, k: int) -> int:
        """Number of the k-th slot of a camera in a bay."""
        return self.layout.slot(bay, camera, k)

    def memory(self, slot: int) -> NDArray[np.uint8]:
        """The bytes of exactly one frame, (nbytes,) uint8; writable where the ring is."""
        start = self.layout.offset(slot)
        return self._bytes[start : start + self._shape(slot).nbytes]

    def frame(self, slot: int) -> NDArray[Any]:
        """The picture in a slot, (h, w) or under a Bayer filter (h, w, 3), uint8 or uint16 at full scale.

        Mono8 and Mono16 are seen in place, writable where the ring is; other formats are unpacked into a picture of
        its own.
        """
        shape = self._shape(slot)
        return picture(self.memory(slot), shape.width, shape.height, shape.format)

    def claim(self, bay: int) -> int:
        """Give a bay to a coming run: a new generation, and all its pixels zero; returns the generation.

        Whoever decides about memory (the station) claims *before* it grants the bay to the cameras. Holes
        of an incomplete frame are then black and never show the board before.
        """
        self._must_write("claim")
        first = self.layout.slot(bay, 0, 0)
        last = first + self.layout.slots_per_bay
        generation = int(self._header["generation"][0]) + 1
        self._header["generation"] = generation
        self._bays["generation"][bay] = generation  # before the pixels go: readers look at it afterwards
        self._slots[first:last] = (generation, 0, NO_ROW, 0, 0)
        self._bytes[self.layout.offset(first) : self.layout.offset(last)] = 0
        return generation

    def generation(self, bay: int) -> int:
        """Generation of a bay; 0: never used."""
        self.layout.slot(bay, 0, 0)
        return int(self._bays["generation"][bay])

    def check(self, bay: int, generation: int) -> None:
        """GoneError if the bay has been given to another board; call it before *and after* looking."""
        now = self.generation(bay)
        if now != generation:
            raise GoneError(
                f"bay {bay} of the ring holds generation {now}, not {generation}: its memory went to a later board.",
                action="Hold a run while you use it, or keep a recording of it.",
            )

    def snapshot(self, slot: int, generation: int) -> NDArray[Any]:
        """A copy of one frame, checked before and after; GoneError if the board has changed meanwhile."""
        bay = self.layout.place(slot)[0]
        self.check(bay, generation)
        pixels = self.frame(slot).copy()
        self.check(bay, generation)
        return pixels

    def clear(self, slot: int) -> None:
        """Blacken one slot, so that it can be filled again in the same generation."""
        self._must_write("clear")
        self.memory(slot)[:] = 0
        self.note(slot, 0, NO_ROW, None)

    def note(self, slot: int, state: int, row: int, frame_id: int | None) -> None:
        """Say in the slot table what a slot holds, for tester software that reads the ring by itself."""
        self._must_write("note")
        bay = self.layout.place(slot)[0]
        self._slots[slot] = (self.generation(bay), state, row, frame_id or 0, 0)

    def record(self, slot: int) -> tuple[int, int, int, int]:
        """Generation, state, row and frame id the slot table has for a slot."""
        self.layout.place(slot)
        entry = self._slots[slot]
        return int(entry["generation"]), int(entry["state"]), int(entry["row"]), int(entry["frame_id"])

    def close(self) -> None:
        """Unmap; the owner also unlinks the file. Views still held keep their memory until they die."""
        if self._map is None:
            return
        if self.owned:
            self._header["state"] = CLOSED
            with contextlib.suppress(FileNotFoundError):
                if self.path.stat().st_ino == self._inode:
                    self.path.unlink()
        if self._handle is not None:
            os.close(self._handle)
        mapped, self._map = self._map, None
        del self._bytes, self._header, self._bays, self._slots
        with contextlib.suppress(BufferError):  # somebody still looks: unmapped when the last view goes
            mapped.close()

    def __enter__(self) -> Ring:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _shape(self, slot: int) -> FrameShape:
        return self.layout.frames[self.layout.place(slot)[1]]

    def _table(self, offset: int, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        return self._bytes[offset : offset + count * dtype.itemsize].view(dtype)

    def _must_write(self, verb: str) -> None:
        if not self.writable:
            raise StateError(f"{self.path}: is mapped read-only; only the station may {verb} its memory.")
