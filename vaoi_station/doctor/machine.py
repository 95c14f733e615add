"""What the kernel says of this machine; `root` may be another one, so that every answer can be put to the test."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

CAP_IPC_LOCK = 14
PSEUDO_TERMINALS = range(136, 144)
"""Major numbers; they are not in /sys."""


@dataclass(frozen=True)
class Holder:
    """A process that has a file open."""

    pid: int
    name: str


@dataclass(frozen=True)
class Machine:
    """Reads /proc, /sys and /run below `root`; what is not there is None."""

    root: Path = Path("/")

    def text(self, path: str) -> str | None:
        """Content of a file, stripped."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def number(self, path: str) -> int | None:
        """A file that holds one whole number."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def sysctl(self, name: str) -> int | None:
        """A kernel parameter such as net.core.rmem_max."""
        return self.number(f"proc/sys/{name.replace('.', '/')}")

    def available_memory(self) -> int | None:
        """Bytes that programs could still get."""
        return self._kibibytes("proc/meminfo", "MemAvailable")

    def filesystem_of(self, path: Path) -> str | None:
        """Type of the file system that a path is on, such as tmpfs."""
        best, kind = "", None
        for line in (self.text("proc/mounts") or "").splitlines():
            words = line.split()
            mount = words[1].replace("\\040", " ") if len(words) > 2 else ""
            if mount and len(mount) >= len(best) and path.resolve().is_relative_to(mount):
                best, kind = mount, words[2]
        return kind

    def may_lock_anything(self) -> bool:
        """Whether this process has the capability that no memory limit binds."""
        status = self.text("proc/self/status") or ""
        held = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
        return bool(int(held, 16) >> CAP_IPC_LOCK & 1)

    def locked_bytes(self, pid: int) -> int | None:
        """Memory that a process has locked."""
        return self._kibibytes(f"proc/{pid}/status", "VmLck")

    def terminal(self, device: int) -> bool:
        """Whether a device number is that of a serial port, as far as the kernel tells; nothing is opened for that."""
        if os.major(device) in PSEUDO_TERMINALS:
            return True
        entry = self.root / "sys/dev/char" / f"{os.major(device)}:{os.minor(device)}"
        return not entry.exists() or (entry / "subsystem").resolve().name == "tty"

    def holders(self, device: Path) -> Iterator[Holder]:
        """Processes that have a file open, as far as they may be seen."""
        for entry in sorted((self.root / "proc").glob("[0-9]*")):
            with contextlib.suppress(OSError):  # it has ended, or is somebody else's
                if any(_leads_to(handle, device) for handle in (entry / "fd").iterdir()):
                    yield Holder(int(entry.name), self.text(f"proc/{entry.name}/comm") or "")

    def _kibibytes(self, path: str, key: str) -> int | None:
        for line in (self.text(path) or "").splitlines():
            if line.startswith(f"{key}:"):
                return int(line.split()[1]) * 1024
        return None


def _leads_to(handle: Path, device: Path) -> bool:
    try:
        return handle.samefile(device)
    except OSError:
        return False


def nearest(path: Path) -> Path:
    """The path, or the first of its parents that is there and may be seen."""
    return next(p for p in (path, *path.parents) if _seen(p))


def writable(path: Path) -> bool:
    """Whether files can be made in a directory, or the directory itself made, by this user."""
    there = nearest(path)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK, effective_ids=True)


def is_directory(path: Path) -> bool:
    """Whether it is one that this user may see."""
    return nearest(path) == path and path.is_dir()


def _seen(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # in a directory of somebody else
        return False


def format_bytes(count: float) -> str:
    """Bytes for people: 2.1 GB, 348 MB, 64 kB."""
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count / 1e3:.3g} kB"
