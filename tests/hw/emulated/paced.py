"""The emulated chip at the pace of the clock, its serial line behind a pseudo terminal."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from vaoi_station.rig.device_process import raise_priority

T = TypeVar("T")

HZ = 16_000_000
PATIENCE_S = 30.0
"""No test hangs for longer; nothing is measured by it."""


class PacedChip:
    """`emulator --pty`; see hw/virtual_rig/README.md. A thread reads its output."""

    def __init__(self, build: Path, link: Path, firmware: str = "firmware.elf") -> None:
        self.link = link
        self.process = subprocess.Popen(
            [str(build / "emulator"), str(build / firmware), "--pty", str(link)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        # A chip does not wait for the computer's other work, and a late reply is to the station a missing one.
        raise_priority(self.process.pid)
        self.edges: list[tuple[int, str, int]] = []
        """(cycle, pin, level) of all outputs."""
        self.resets: list[int] = []
        self._clock: list[tuple[int, int]] = []
        self._done: list[int] = []
        self._asked = 0
        self._over = False
        self._change = threading.Condition()
        self._reader = threading.Thread(target=self._read, name="emulator")
        self._reader.start()
        self.wait(lambda: self._clock)

    def do(self, command: str) -> int:
        """Execute one command; return the cycle at which it was carried out."""
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        self._asked += 1
        self.wait(lambda: len(self._done) >= self._asked)
        return self._done[self._asked - 1]

    def board(self, ms: float) -> int:
        """Block the barrier for a time; return the cycle at which it begins."""
        return self.do(f"board {round(ms * HZ / 1000)}")

    def rest(self, ms: float) -> None:
        """Wait until this time has passed on the chip."""
        until = self.do("pin PD2 0") + ms * HZ / 1000
        while self.do("pin PD2 0") < until:
            pass

    def host_s(self, cycle: int) -> float:
        """time.monotonic() of a cycle."""
        at, ns = max(c for c in self._clock if c[0] <= cycle)
        return ns * 1e-9 + (cycle - at) / HZ

    def rises(self, pin: str) -> list[int]:
        """Cycles at which an output went up, until now: what comes before the answer to a command has been read."""
        self.do("pin PD2 0")
        with self._change:
            return [cycle for cycle, name, level in self.edges if name == pin and level]

    def wait(self, condition: Callable[[], T]) -> T:
        """Wait until the output makes this condition true."""
        with self._change:
            assert self._change.wait_for(condition, PATIENCE_S), "the emulator did not print the expected line"
            return condition()

    def close(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        assert self.process.wait(PATIENCE_S) == 0
        self._reader.join()
        self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            word, *rest = line.split()
            with self._change:
                if word == "edge":
                    self.edges.append((int(rest[0]), rest[1], int(rest[2])))
                elif word == "reset":
                    self.resets.append(int(rest[0]))
                elif word == "clock":
                    self._clock.append((int(rest[0]), int(rest[1])))
                elif word == "ok":
                    self._done.append(int(rest[0]))
                self._change.notify_all()
