"""What each process of the station uses, read from /proc (manual page proc(5)), and what its files use."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from vaoi_station.benchmarks.process_usage import cpu_s

_SMAPS = re.compile(r"^(Rss|Pss|Anonymous): +(\d+) kB", re.MULTILINE)
_THREADS = re.compile(r"^Threads:\s+(\d+)", re.MULTILINE)
MB = 1e6


def process_usage(pid: int) -> dict[str, float] | None:
    """Return memory in MB, descriptors, threads and CPU time of a process; None if it has ended."""
    with suppress(OSError):
        kept = {key.lower(): int(kb) * 1024 / MB for key, kb in _SMAPS.findall(_read(pid, "smaps_rollup"))}
        if not kept:
            return None
        threads = _THREADS.search(_read(pid, "status"))
        return {
            "rss_mb": kept["rss"],
            "pss_mb": kept["pss"],
            "anonymous_mb": kept["anonymous"],
            "descriptors": len(list(Path(f"/proc/{pid}/fd").iterdir())),
            "threads": int(threads[1]) if threads else 0,
            "cpu_s": cpu_s(pid),
        }
    return None


def station_usage(pid: int, station: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the usage of the station's processes by their roles, each with its process id."""
    pids = {"station": pid} | {p["name"]: p["pid"] for p in station["processes"] if p.get("pid")}
    found = {role: process_usage(number) for role, number in pids.items()}
    return {role: usage | {"pid": pids[role]} for role, usage in found.items() if usage is not None}


def file_usage(data: Path, shm: Path) -> dict[str, float]:
    """Return the sizes in MB of the database with its log, of all files of the data directory, and of the ring."""
    # os.walk passes over folders that are deleted meanwhile; Path.rglob of Python 3.11 raises.
    files = (Path(folder, name) for folder, _, names in os.walk(data) for name in names)
    sizes = {path: size for path in files if (size := _size(path)) is not None}
    database = sum(size for path, size in sizes.items() if path.name.startswith("station.db"))
    rings = [size for path in shm.iterdir() if (size := _size(path)) is not None]
    return {
        "database_mb": database / MB,
        "data_mb": sum(sizes.values()) / MB,
        "data_files": len(sizes),
        "shared_memory_mb": sum(rings) / MB,
        "shared_memory_files": len(rings),
    }


def _size(path: Path) -> int | None:
    """Return the bytes that a file occupies; None if it is no file, or was deleted meanwhile."""
    with suppress(OSError):
        state = path.lstat()
        return state.st_blocks * 512 if not path.is_dir() else None
    return None


def _read(pid: int, name: str) -> str:
    return Path(f"/proc/{pid}/{name}").read_text(encoding="utf-8", errors="replace")
