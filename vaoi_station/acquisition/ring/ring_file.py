"""The file of the ring: created exclusively, allocated before use, owned by one process."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import mmap
import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring_layout import (
    CAMERA_RECORD,
    HEADER,
    LAYOUT_VERSION,
    MAGIC,
    PAGE_BYTES,
    RingLayout,
)
from vaoi_station.errors import BusyError, DeviceError, InputError, NotFoundError, StateError

SUFFIX = ".ring"


def start_ticks(pid: int) -> int | None:
    """Return the start time of a process, in kernel ticks since boot; None if there is no such process.

    Pid and start time together identify a process: pids are reused, start times are not.
    """
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
    """Create, lock and allocate the file (mode 0640) and write its header; nothing is left behind on failure.

    Returns:
        The descriptor, which holds the lock.
    """
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
    """Write the header and the camera table, then allocate every block of the file."""
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
