"""Run the firmware on the emulated chip, report the edges of the chip's pins, and send commands to the emulator.

`hw/virtual_rig/README.md` lists the emulator's commands and its lines of output. The emulator keeps pace with
CLOCK_MONOTONIC. So every cycle of the chip has an exact host time, even if the line that reports it arrives late.
"""

from __future__ import annotations

import queue
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from vaoi_station.errors import DeviceError
from vaoi_station.rig.devices.processes import raise_priority, stop_process

HZ = 16_000_000
NS_PER_CYCLE = 62.5
READY_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Edge:
    """A change of the level of one output pin of the chip."""

    cycle: int
    pin: str
    level: bool
    host_ns: int
    """Time of the chip's cycle in which the level changed, ns of CLOCK_MONOTONIC."""


class Chip:
    """The running emulator of the chip, as a context manager.

    A thread of this object calls one function for each edge of the chip's pins, and another one for each reset.
    """

    def __init__(
        self, built: Path, terminal: Path, on_edge: Callable[[Edge], None], on_reset: Callable[[], None] = lambda: None
    ) -> None:
        """Prepare the emulator; it starts when the context is entered.

        Args:
            built: the folder with `firmware.elf` and `emulator`, see `firmware.build`.
            terminal: path of the link that a station opens as the controller's serial port; the emulator creates it.
            on_edge: called with each edge, in the order of the chip's cycles.
            on_reset: called after each reset of the chip.
        """
        self.terminal = terminal
        self._command = [str(built / "emulator"), str(built / "firmware.elf"), "--pty", str(terminal)]
        self._on_edge, self._on_reset = on_edge, on_reset
        self._origin: tuple[int, int] = (0, 0)
        self._ready: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None

    @property
    def pid(self) -> int:
        """Process id of the emulator of the chip."""
        assert self._process is not None
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the emulator of the chip runs."""
        return self._process is not None and self._process.poll() is None

    def cycle_at(self, host_ns: int) -> int:
        """Return the chip's cycle at a time in ns of CLOCK_MONOTONIC."""
        cycle, ns = self._origin
        return cycle + round((host_ns - ns) / NS_PER_CYCLE)

    def host_ns(self, cycle: int) -> int:
        """Return the time of a cycle in ns of CLOCK_MONOTONIC."""
        first, ns = self._origin
        return ns + round((cycle - first) * NS_PER_CYCLE)

    def send(self, command: str) -> None:
        """Send one command line to the emulator.

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
            # In a separate session the emulator does not get Ctrl-C: the rig stops its processes in order.
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,
        )
        raise_priority(self._process.pid)
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name="chip")
        self._reader.start()
        try:
            if not self._ready.get(timeout=READY_TIMEOUT_S):
                raise DeviceError("the emulated chip does not start.")
        except queue.Empty:
            self.__exit__()
            raise DeviceError(f"the emulated chip does not answer within {READY_TIMEOUT_S:.0f} s.") from None
        except BaseException:  # on any failure, Ctrl-C included, no process may be left behind
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process is not None
        stop_process(self._process, STOP_TIMEOUT_S)
        if self._reader is not None:
            self._reader.join()

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                word, *rest = line.split()
                if word == "clock":
                    # This line comes at the start and after each reset, when the emulator starts its clock again.
                    self._origin = (int(rest[0]), int(rest[1]))
                    self._ready.put(True)
                elif word == "edge":
                    cycle = int(rest[0])
                    self._on_edge(Edge(cycle, rest[1], rest[2] == "1", self.host_ns(cycle)))
                elif word == "reset":
                    self._on_reset()
        # End of file: if an emulator ends before it is ready, __enter__ must not wait for the full timeout.
        self._ready.put(False)
