"""Read the state of this machine from the kernel's files under /proc and /sys."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

CAP_IPC_LOCK = 14
PSEUDO_TERMINALS = range(136, 144)
"""Major device numbers of pseudo-terminals, which have no entry in /sys."""


@dataclass(frozen=True)
class Holder:
    """A process that holds a file open."""

    pid: int
    name: str


@dataclass(frozen=True)
class Machine:
    """Reader of the files under /proc and /sys. A value that the kernel does not provide is None.

    Tests pass a `root` folder that contains copies of these files.
    """

    root: Path = Path("/")

    def text(self, path: str) -> str | None:
        """Read a text file; white space at both ends is removed."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def number(self, path: str) -> int | None:
        """Read a file that contains one whole number."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def sysctl(self, name: str) -> int | None:
        """Read a kernel parameter such as net.core.rmem_max."""
        return self.number(f"proc/sys/{name.replace('.', '/')}")

    def available_memory(self) -> int | None:
        """Read how many bytes programs can still allocate."""
        # MemFree would be too low: the kernel gives its page cache back when needed, and MemAvailable includes that.
        return self._kibibytes("proc/meminfo", "MemAvailable")

    def filesystem_of(self, path: Path) -> str | None:
        """Return the type of the file system that holds a path, such as tmpfs."""
        best, kind = "", None
        for line in (self.text("proc/mounts") or "").splitlines():
            words = line.split()
            # The kernel writes a space inside a mount point as \\040.
            mount = words[1].replace("\\040", " ") if len(words) > 2 else ""
            # The longest matching mount point counts. Of two mounts on one point, the later one covers the earlier.
            if mount and len(mount) >= len(best) and path.resolve().is_relative_to(mount):
                best, kind = mount, words[2]
        return kind

    def may_lock_anything(self) -> bool:
        """Return whether this process may lock any amount of memory (capability CAP_IPC_LOCK)."""
        status = self.text("proc/self/status") or ""
        held = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
        return bool(int(held, 16) >> CAP_IPC_LOCK & 1)

    def locked_bytes(self, pid: int) -> int | None:
        """Read how many bytes a process has locked in memory."""
        return self._kibibytes(f"proc/{pid}/status", "VmLck")

    def is_terminal(self, device: int) -> bool:
        """Return whether a device number belongs to a serial port; True if /sys does not know the device."""
        # The device is not opened: opening a serial port resets some controller boards.
        if os.major(device) in PSEUDO_TERMINALS:
            return True
        entry = self.root / "sys/dev/char" / f"{os.major(device)}:{os.minor(device)}"
        return not entry.exists() or (entry / "subsystem").resolve().name == "tty"

    def holders(self, device: Path) -> Iterator[Holder]:
        """Yield the processes that have opened a device file. Processes of other users may be hidden from this user."""
        for entry in sorted((self.root / "proc").glob("[0-9]*")):
            with contextlib.suppress(OSError):  # the process has ended, or belongs to another user
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
    """Return the path itself or, if it does not exist, the nearest parent folder that this user can see."""
    return next(p for p in (path, *path.parents) if _seen(p))


def writable(path: Path) -> bool:
    """Return whether this user can create files in a directory, or can create the directory if it does not exist."""
    there = nearest(path)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK, effective_ids=True)


def is_directory(path: Path) -> bool:
    """Return whether a path is a directory that this user can see."""
    return nearest(path) == path and path.is_dir()


def _seen(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # The path is inside a directory that this user may not search.
        return False


def format_bytes(count: float) -> str:
    """Format a number of bytes with three digits: 2.1 GB, 348 MB, 64 kB."""
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count / 1e3:.3g} kB"
