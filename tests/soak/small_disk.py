"""A data disk that is filled and freed at once: a tmpfs in a mount namespace of its own, whose size is changed."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

SIZE = 3_000_000_000
"""Size of the disk in bytes. The station makes room on a disk with less than 1 GB left, which is not what is soaked."""
TRIES = 50
"""Most attempts to make the disk as small as what it holds."""
_PAGE = 4096


class SmallDisk:
    """A tmpfs over a directory. It is visible to programs that are started with `prefix`."""

    def __init__(self, directory: Path) -> None:
        directory.mkdir(exist_ok=True)
        own = [] if os.geteuid() == 0 else ["--map-root-user"]
        mount = f"mount -t tmpfs -o size={SIZE} tmpfs '{directory}' && echo mounted && exec cat"
        self._holder = subprocess.Popen(
            ["unshare", "--mount", *own, "sh", "-c", mount], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != "mounted\n":
            raise RuntimeError(f"{directory}: no file system could be mounted in a mount namespace")
        user = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        self.prefix = ["nsenter", f"--target={self._holder.pid}", "--mount", *user, f"--wd={Path.cwd()}"]
        self.directory = Path(f"/proc/{self._holder.pid}/root{directory}")
        self._mounted_at = directory

    def fill(self) -> None:
        """Leave no free page."""
        for _ in range(TRIES):
            state = os.statvfs(self.directory)
            if self._resize(max((state.f_blocks - state.f_bfree) * state.f_frsize, _PAGE)):
                return
            # The station has written meanwhile: a tmpfs cannot be made smaller than what it holds.
        raise RuntimeError(f"{self.directory}: grew {TRIES} times while it was made smaller")

    def make_room(self) -> None:
        """Give the disk its full size again."""
        assert self._resize(SIZE)

    def close(self) -> None:
        """Unmount it; its files are lost."""
        self._holder.communicate()

    def _resize(self, size: int) -> bool:
        command = ["mount", "-o", f"remount,size={size}", str(self._mounted_at)]
        return subprocess.run([*self.prefix, *command], check=False, capture_output=True).returncode == 0
