"""The ring: frames in shared memory, written by cameras and read in place by other processes (docs/reference/ring.md).

    header page │ camera table │ bay table │ slot table │ bay 0: camera 0: slot 0, slot 1 … │ bay 1 …

One process, the station, creates the file and unlinks it. A bay's **generation** changes when the bay is given to
another board: a reader that finds the same one before and after it has read pixels knows to which run they belong.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import mmap
import os
import stat
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, DeviceError, GoneError, InputError, NotFoundError, StateError
from vaoi_station.pixel_formats import PIXEL_FORMATS, PixelFormat, picture

MAGIC = b"VAOIRING"
LAYOUT_VERSION = 1
PAGE_BYTES = 4096

BUILDING, IN_USE, CLOSED = 0, 1, 2
EMPTY, OK, INCOMPLETE = 0, 1, 2
NO_ROW = 0xFFFFFFFF

# Offsets are explicit: other programs take them from ring.md, so no compiler and no NumPy alignment may move a field.
HEADER = np.dtype(
    {
        "names": [
            "magic", "layout_version", "header_bytes", "file_bytes", "generation", "owner_pid", "state",
            "owner_start_ticks", "bays", "cameras", "slots_per_camera", "page_bytes", "slot_bytes",
            "camera_table", "bay_table", "slot_table", "first_slot",
        ],
        "formats": ["S8", "<u4", "<u4", "<u8", "<u8", "<u4", "<u4", "<u8", *["<u4"] * 4, *["<u8"] * 5],
        "offsets": [0, 8, 12, 16, 24, 32, 36, 40, 48, 52, 56, 60, 64, 72, 80, 88, 96],
        "itemsize": PAGE_BYTES,
    }
)  # fmt: skip
CAMERA_RECORD = np.dtype([("width", "<u4"), ("height", "<u4"), ("pixel_format", "<u4"), ("bytes_per_pixel", "<u4")])
BAY_RECORD = np.dtype([("generation", "<u8"), ("reserved", "<u8")])
SLOT_RECORD = np.dtype(
    [("generation", "<u8"), ("state", "<u4"), ("row", "<u4"), ("frame_id", "<u8"), ("reserved", "<u8")]
)


@dataclass(frozen=True)
class FrameShape:
    """Size and pixel format of the frames of one camera."""

    width: int
    height: int
    pixel_format: str

    def __post_init__(self) -> None:
        if self.pixel_format not in PIXEL_FORMATS:
            raise InputError.field("ring", "pixel_format", self.pixel_format, f"one of {', '.join(PIXEL_FORMATS)}")

    @property
    def format(self) -> PixelFormat:
        """The pixel format, which defines how the bytes of a frame are converted to a picture."""
        return PIXEL_FORMATS[self.pixel_format]

    @property
    def nbytes(self) -> int:
        """Size of the pixels of one frame, bytes."""
        return self.format.nbytes(self.width, self.height)


@dataclass(frozen=True)
class RingLayout:
    """The layout of a ring's file: counts and frame sizes, and all offsets computed from them."""

    bays: int
    slots_per_camera: int
    frames: tuple[FrameShape, ...]
    room_bytes: int = 0
    """Bytes behind the largest frame that every slot has as well, whole pages: cameras write chunk data there."""

    def __post_init__(self) -> None:
        for key in ("bays", "slots_per_camera"):
            if getattr(self, key) < 1:
                raise InputError.field("ring", key, getattr(self, key), "at least 1")
        if not self.frames:
            raise InputError("ring: there is no camera; the ring holds the frames of at least one.")

    @classmethod
    def of(cls, config: StationConfig) -> RingLayout:
        """Return a station's layout: `ring.runs` bays, each with slots for the longest board and the spare rows."""
        shapes = tuple(FrameShape(c.width, c.height, c.pixel_format) for c in config.cameras)
        room_bytes = _pages(max(c.chunk_room_bytes for c in config.cameras))
        return cls(config.ring.runs, config.rows_per_run, shapes, room_bytes)

    @property
    def cameras(self) -> int:
        """Count of cameras (n in the paper)."""
        return len(self.frames)

    @property
    def slots_per_bay(self) -> int:
        """Count of slots in one bay, for all cameras together."""
        return self.cameras * self.slots_per_camera

    @property
    def slots(self) -> int:
        """Count of slots in the whole ring."""
        return self.bays * self.slots_per_bay

    @cached_property
    def slot_bytes(self) -> int:
        """Distance between the starts of two slots, bytes: the largest frame in whole pages, and the room behind it."""
        return _pages(max(f.nbytes for f in self.frames)) + self.room_bytes

    @property
    def camera_table(self) -> int:
        """Offset of the camera table in the file, bytes."""
        return PAGE_BYTES

    @property
    def bay_table(self) -> int:
        """Offset of the bay table in the file, bytes."""
        return self.camera_table + _pages(self.cameras * CAMERA_RECORD.itemsize)

    @property
    def slot_table(self) -> int:
        """Offset of the slot table in the file, bytes."""
        return self.bay_table + _pages(self.bays * BAY_RECORD.itemsize)

    @cached_property
    def first_slot(self) -> int:
        """Offset of slot 0 in the file, bytes."""
        return self.slot_table + _pages(self.slots * SLOT_RECORD.itemsize)

    @property
    def file_bytes(self) -> int:
        """Size of the ring's file, bytes."""
        return self.first_slot + self.slots * self.slot_bytes

    def slot(self, bay: int, camera: int, k: int) -> int:
        """Return the number of the slot with index k, among the slots of one camera in one bay."""
        limits = (("bay", bay, self.bays), ("camera", camera, self.cameras), ("slot", k, self.slots_per_camera))
        for what, value, count in limits:
            if not 0 <= value < count:
                raise InputError.field("ring", what, value, f"0 … {count - 1}")
        return (bay * self.cameras + camera) * self.slots_per_camera + k

    def place(self, slot: int) -> tuple[int, int, int]:
        """Return (bay, camera, k) for the number of a slot. k counts the slots of this camera in this bay."""
        if not 0 <= slot < self.slots:
            raise InputError.field("ring", "slot", slot, f"0 … {self.slots - 1}")
        rest, k = divmod(slot, self.slots_per_camera)
        bay, camera = divmod(rest, self.cameras)
        return bay, camera, k

    def offset(self, slot: int) -> int:
        """Return the offset of a slot's first byte in the file."""
        return self.first_slot + slot * self.slot_bytes

    def header(self, pid: int, start_ticks: int) -> NDArray[Any]:
        """Return the header page as an array (1,), in the state BUILDING."""
        page = np.zeros(1, dtype=HEADER)
        page["magic"] = MAGIC
        for key, value in (
            ("layout_version", LAYOUT_VERSION), ("header_bytes", PAGE_BYTES), ("file_bytes", self.file_bytes),
            ("owner_pid", pid), ("owner_start_ticks", start_ticks), ("state", BUILDING), ("bays", self.bays),
            ("cameras", self.cameras), ("slots_per_camera", self.slots_per_camera), ("page_bytes", PAGE_BYTES),
            ("slot_bytes", self.slot_bytes), ("camera_table", self.camera_table), ("bay_table", self.bay_table),
            ("slot_table", self.slot_table), ("first_slot", self.first_slot),
        ):  # fmt: skip
            page[key] = value
        return page

    def camera_records(self) -> NDArray[Any]:
        """Return the camera table as an array (cameras,) of records."""
        rows = [(f.width, f.height, f.format.code, f.format.bytes_per_pixel) for f in self.frames]
        return np.array(rows, dtype=CAMERA_RECORD)

    @classmethod
    def read(cls, header: NDArray[Any], cameras: NDArray[Any]) -> RingLayout:
        """Read the layout of a file from its `header` (1,) HEADER and its camera table `cameras` (n,) CAMERA_RECORD."""
        # An unknown code is kept as hexadecimal text. FrameShape then refuses it with the list of known formats.
        names = {known.code: name for name, known in PIXEL_FORMATS.items()}
        frames = tuple(
            FrameShape(int(c["width"]), int(c["height"]), names.get(int(c["pixel_format"]), hex(c["pixel_format"])))
            for c in cameras
        )
        plain = cls(int(header["bays"][0]), int(header["slots_per_camera"][0]), frames)
        return replace(plain, room_bytes=max(int(header["slot_bytes"][0]) - plain.slot_bytes, 0))


def _pages(nbytes: int) -> int:
    return -(-nbytes // PAGE_BYTES) * PAGE_BYTES


SUFFIX = ".ring"


def start_ticks(pid: int) -> int | None:
    """Return the start time of a process, kernel ticks since boot; None without it. A reused pid has another one."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return None
    # The name of the program, in parentheses, may itself contain blanks and parentheses (proc(5)).
    state, *fields = stat.rpartition(")")[2].split()
    # A zombie process no longer holds memory. The list begins with field 4 of stat; field 22 is the start time.
    return None if state in "ZX" else int(fields[18])


def read_owner(path: Path) -> tuple[int, bool] | None:
    """Return the process id of a ring's owner, and whether this process lives; None if the file is not a ring.

    The owner keeps the file locked while it lives. The lock is visible even where its pid is not (containers).
    """
    try:
        handle = _open_regular(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        page = os.pread(handle, PAGE_BYTES, 0)
        locked = _is_locked(handle)
    finally:
        os.close(handle)
    if len(page) < PAGE_BYTES or page[:8] != MAGIC:
        return None
    header = np.frombuffer(page, dtype=HEADER)
    pid = int(header["owner_pid"][0])
    return pid, locked or start_ticks(pid) == int(header["owner_start_ticks"][0])


def remove_leftovers(directory: Path) -> list[Path]:
    """Delete the ring files of processes that ended without deleting them; return the paths of the deleted files."""
    removed = []
    for path in sorted(directory.glob(f"*{SUFFIX}")):
        owner = read_owner(path)
        if owner is not None and not owner[1]:
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
                removed.append(path)
    return removed


def create_file(path: Path, layout: RingLayout) -> int:
    """Create, lock and allocate the file (mode 0640) and write its header; nothing is left behind on failure."""
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o640)
    except FileExistsError:
        raise _taken(path) from None
    except OSError as error:
        raise InputError(
            f"ring {path}: cannot be created ({error.strerror}).",
            action="Set [ring] directory to a directory that the station may write to.",
            code="ring-directory",
        ) from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        # The umask may have removed the group's right to read.
        os.fchmod(handle, 0o640)
        _allocate(handle, path, layout)
    except BaseException:  # also KeyboardInterrupt: remove the file, then raise it again
        os.close(handle)
        path.unlink(missing_ok=True)
        raise
    return handle


def map_file(handle: int, nbytes: int, writable: bool) -> mmap.mmap:
    """Map the whole file into memory."""
    # MAP_POPULATE fills the page tables now: otherwise page faults delay the first frames.
    flags = mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0)
    return mmap.mmap(handle, nbytes, flags=flags, prot=mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0))


def lock_in_ram(memory: NDArray[np.uint8]) -> str:
    """Lock the mapped pages in RAM. Return an empty string or, if not permitted, a sentence with the cause."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlock(ctypes.c_void_p(memory.ctypes.data), ctypes.c_size_t(memory.nbytes)) == 0:
        return ""
    reason = os.strerror(ctypes.get_errno())
    return (
        f"The ring's {_mib(memory.nbytes)} are not locked in memory ({reason}); under memory pressure frames may be "
        "late. Raise LimitMEMLOCK of the service."
    )


def read_layout(handle: int, path: Path) -> tuple[RingLayout, NDArray[Any]]:
    """Return the layout and the header of an existing ring. Check both against the size of the file."""
    page = os.pread(handle, PAGE_BYTES, 0)
    if len(page) < PAGE_BYTES or page[:8] != MAGIC:
        raise InputError(f"{path}: is not a ring of vaoi_station.")
    header = np.frombuffer(page, dtype=HEADER)
    if (found := int(header["layout_version"][0])) != LAYOUT_VERSION:
        raise InputError.field(path, "layout_version", found, str(LAYOUT_VERSION), "Use matching versions.")
    size, table_bytes = os.fstat(handle).st_size, int(header["cameras"][0]) * CAMERA_RECORD.itemsize
    # The header may be that of another program: no memory is taken by numbers that contradict the size of the file.
    if (end := int(header["camera_table"][0]) + table_bytes) > size:
        raise InputError(f"{path}: has {size} bytes, but its header states cameras up to byte {end}.")
    table = os.pread(handle, table_bytes, int(header["camera_table"][0]))
    layout = RingLayout.read(header, np.frombuffer(table, dtype=CAMERA_RECORD))
    if size != layout.file_bytes:
        raise InputError(f"{path}: has {size} bytes, but its header states {layout.file_bytes}.")
    return layout, header


def open_existing(path: Path, writable: bool) -> int:
    """Open the file of an existing ring, and return its file descriptor."""
    try:
        return _open_regular(path, os.O_RDWR if writable else os.O_RDONLY)
    except FileNotFoundError:
        raise NotFoundError(f"{path}: there is no such ring.", action="Start the station first.") from None
    except PermissionError:
        raise InputError(f"{path}: cannot be opened.", action="Join the group of the station's service.") from None
    except OSError as error:
        raise InputError(f"{path}: is not a ring of vaoi_station ({error.strerror}).") from error


def _open_regular(path: Path, flags: int) -> int:
    """Open a regular file; raise OSError for everything else, at once."""
    # Without O_NONBLOCK, a FIFO of any user in /dev/shm would block the start for ever. Links are not followed: a link
    # may lead to itself, or to a device that reacts when it is opened.
    handle = os.open(path, flags | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return handle


def _is_locked(handle: int) -> bool:
    # A shared lock, which is released when the caller closes the file: readers do not exclude one another.
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def _allocate(handle: int, path: Path, layout: RingLayout) -> None:
    pid = os.getpid()
    free = os.fstatvfs(handle)
    if (available := free.f_bavail * free.f_frsize) < layout.file_bytes:
        raise _full(path, layout, f"{_mib(available)} are free")
    try:
        # The header is written first: if this process dies now, the file names its owner and is removed later.
        os.pwrite(handle, layout.header(pid, start_ticks(pid) or 0).tobytes(), 0)
        os.posix_fallocate(handle, 0, layout.file_bytes)
        os.pwrite(handle, layout.camera_records().tobytes(), layout.camera_table)
    except OverflowError:
        raise _full(path, layout, "no file can be that large") from None
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.ENOMEM):
            raise _full(path, layout, str(error.strerror)) from error
        raise DeviceError(f"ring {path}: cannot be allocated ({error.strerror}).") from error


def _full(path: Path, layout: RingLayout, why: str) -> BusyError:
    return BusyError(
        f"ring {path}: needs {_mib(layout.file_bytes)} ({layout.bays} runs × {layout.cameras} cameras × "
        f"{layout.slots_per_camera} rows × {_mib(layout.slot_bytes)}), but {why}.",
        action="Lower [ring] runs or [line] longest_board_mm, free the shared memory, or give it more room.",
        code="ring-too-large",
    )


def _taken(path: Path) -> StateError:
    owner = read_owner(path)
    who = f"process {owner[0]}" if owner else "another program"
    return StateError(
        f"ring {path}: exists already and belongs to {who}.",
        action="Stop the other station, or give this one another name; remove the file if no program uses it.",
        code="ring-taken",
    )


def _mib(nbytes: int) -> str:
    return f"{nbytes / 2**20:.1f} MiB"


def ring_path(config: StationConfig) -> Path:
    """Return the path of a station's ring."""
    return config.ring.directory / f"vaoi-{config.name}{SUFFIX}"


class Ring:
    """The open ring with its frames. The process that called `create` owns the ring; `attach` only maps it."""

    def __init__(self, path: Path, layout: RingLayout, handle: int, *, writable: bool, owner: bool) -> None:
        self.path = path
        self.layout = layout
        self.writable = writable
        self.lock_note = ""
        """Why the memory could not be locked in RAM; empty if it is locked, and in processes that only map the ring."""
        self._inode = os.fstat(handle).st_ino
        self._owner_pid = os.getpid() if owner else None
        self._handle = handle if owner else None
        """Descriptor that holds the owner's lock on the file; None in processes that only map the ring."""
        self._map: mmap.mmap | None = map_file(handle, layout.file_bytes, writable)
        self._bytes: NDArray[np.uint8] = np.frombuffer(self._map, dtype=np.uint8)
        self._header = self._table(0, 1, HEADER)
        self._bays = self._table(layout.bay_table, layout.bays, BAY_RECORD)
        self._slots = self._table(layout.slot_table, layout.slots, SLOT_RECORD)

    @classmethod
    def create(cls, path: Path, layout: RingLayout) -> Ring:
        """Create the file (exclusively, mode 0640), allocate and lock it. If this fails, remove the file again."""
        # Rings whose owner has ended are removed first: they occupy memory and perhaps this path.
        remove_leftovers(path.parent)
        handle = create_file(path, layout)
        try:
            ring = cls(path, layout, handle, writable=True, owner=True)
        except BaseException:  # also KeyboardInterrupt: remove the file, then raise it again
            path.unlink(missing_ok=True)
            os.close(handle)
            raise
        ring.lock_note = lock_in_ram(ring._bytes)
        ring._slots["row"] = NO_ROW
        # This comes last: readers refuse the file in any other state.
        ring._header["state"] = IN_USE
        return ring

    @classmethod
    def attach(cls, path: Path, writable: bool = False) -> Ring:
        """Map a ring that another process owns."""
        handle = open_existing(path, writable)
        try:
            layout, header = read_layout(handle, path)
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
        """Raise the generation of a bay, and return it: its readers notice that. `blacken` it next."""
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
        """Set all pixels of a bay to zero, so that holes of an incomplete frame never show an earlier board."""
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
                code="frames-gone",
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
