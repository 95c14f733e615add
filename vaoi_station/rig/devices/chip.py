"""The firmware on its emulated chip: built, started behind a terminal, its pins in our hands.

See `hw/virtual_rig/README.md` for what the emulator is told and tells. It keeps the pace of CLOCK_MONOTONIC, so every
cycle has a time of this computer, however late we hear of it.
"""

from __future__ import annotations

import queue
import shutil
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from vaoi_station import __version__
from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.rig.devices.processes import go_first, see_off

HZ = 16_000_000
NS_PER_CYCLE = 62.5
SOURCES = Path(__file__).resolve().parents[3] / "hw" / "firmware"
READY_S = 10.0
END_S = 5.0
_TOOLS = {"make": "make", "gcc": "gcc", "avr-gcc": "gcc-avr avr-libc"}


@dataclass(frozen=True)
class Edge:
    """An output has changed."""

    cycle: int
    pin: str
    level: bool
    host_ns: int
    """CLOCK_MONOTONIC of the cycle."""


def check_sources() -> None:
    """Refuse at once what would be found out when the boards have been filmed.

    Raises:
        NotFoundError: the package was installed without the firmware's sources.
        DeviceError: a tool is missing.
    """
    if not (SOURCES / "Makefile").is_file():
        raise NotFoundError(
            "the rig runs the real firmware, whose sources are not part of an installed package (there is no "
            f"{SOURCES}).",
            action=f"Get the sources of version {__version__}; in their directory: python -m vaoi_station rig …",
        )
    if missing := [packages for tool, packages in _TOOLS.items() if shutil.which(tool) is None]:
        words = f"Install the distribution's packages {' '.join(missing)} libsimavr-dev libelf-dev."
        raise DeviceError("the firmware cannot be built here.", action=words)


def build(folder: Path) -> Path:
    """Firmware and emulator, made from `hw/firmware` beside the package.

    Returns:
        The folder, with `firmware.elf` and `emulator`.

    Raises:
        NotFoundError, DeviceError: see `check_sources`; or the build fails, and the message has its words.
    """
    check_sources()
    command = ["make", "-C", str(SOURCES), f"BUILD={folder.resolve()}", "all", "emulator"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceError(f"the firmware does not build: {(done.stderr or done.stdout).strip()[-1000:]}")
    return folder


class Chip:
    """The running emulator; a context manager. Edges are passed on by a thread of its own."""

    def __init__(
        self, built: Path, terminal: Path, heard: Callable[[Edge], None], restarted: Callable[[], None] = lambda: None
    ) -> None:
        """`terminal` is the link that a station opens as the controller's port; `restarted` hears of resets."""
        self.terminal = terminal
        self._command = [str(built / "emulator"), str(built / "firmware.elf"), "--pty", str(terminal)]
        self._heard, self._restarted = heard, restarted
        self._origin: tuple[int, int] = (0, 0)
        self._ready: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None

    @property
    def pid(self) -> int:
        """Of the emulator."""
        assert self._process is not None
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the emulator runs."""
        return self._process is not None and self._process.poll() is None

    def cycle_at(self, host_ns: int) -> int:
        """The chip's cycle at a time of CLOCK_MONOTONIC."""
        cycle, ns = self._origin
        return cycle + round((host_ns - ns) / NS_PER_CYCLE)

    def host_ns(self, cycle: int) -> int:
        """CLOCK_MONOTONIC of a cycle."""
        first, ns = self._origin
        return ns + round((cycle - first) * NS_PER_CYCLE)

    def tell(self, command: str) -> None:
        """One command.

        Raises:
            DeviceError: the emulator has ended.
        """
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(command + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise DeviceError("the emulated chip has ended.") from None

    def __enter__(self) -> Chip:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, start_new_session=True
        )
        go_first(self._process.pid)
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name="chip")
        self._reader.start()
        try:
            if not self._ready.get(timeout=READY_S):
                raise DeviceError("the emulated chip does not start.")
        except queue.Empty:
            self.__exit__()
            raise DeviceError(f"the emulated chip says nothing for {READY_S:.0f} s.") from None
        except BaseException:  # whatever it was: no process is left behind
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process is not None
        see_off(self._process, END_S)
        if self._reader is not None:
            self._reader.join()

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                word, *rest = line.split()
                if word == "clock":
                    self._origin = (int(rest[0]), int(rest[1]))
                    self._ready.put(True)
                elif word == "edge":
                    cycle = int(rest[0])
                    self._heard(Edge(cycle, rest[1], rest[2] == "1", self.host_ns(cycle)))
                elif word == "reset":
                    self._restarted()
        self._ready.put(False)
