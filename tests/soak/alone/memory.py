"""What a process that is soaked alone uses, read from inside it."""

from __future__ import annotations

import _sqlite3
import ctypes
import gc
from pathlib import Path


def private_mb() -> float:
    """Return the private memory of this process, MB."""
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="ascii").splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) * 1024 / 1e6


def trimmed_mb() -> float:
    """Return the private memory of this process after the C library has given back what it can, MB."""
    ctypes.CDLL(None).malloc_trim(0)
    return private_mb()


def objects() -> int:
    """Return the number of objects of Python that the collector tracks, after a collection."""
    gc.collect()
    return len(gc.get_objects()) + gc.get_freeze_count()


class _Mallinfo2(ctypes.Structure):
    """The structure of mallinfo(3)."""

    _fields_ = [
        *((name, ctypes.c_size_t) for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd")),
        *((name, ctypes.c_size_t) for name in ("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")),
    ]


def heaps_mb() -> float:
    """Return what is in use of the heaps of the C library, of all threads, MB. Python keeps small objects elsewhere."""
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = _Mallinfo2
    return float(mallinfo2().uordblks) / 1e6


def database_mb() -> float:
    """Return how much of these heaps SQLite uses, mostly for pages of the database, MB."""
    used = ctypes.CDLL(_sqlite3.__file__).sqlite3_memory_used
    used.restype = ctypes.c_int64
    return float(used()) / 1e6
