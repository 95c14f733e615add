"""Building the firmware, and its binary on an emulated chip."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[3] / "hw" / "firmware"
CYCLES_PER_US = 16


def make(target: str, build: Path) -> None:
    """One target of the firmware's Makefile, built aside."""
    done = subprocess.run(
        ["make", "-C", str(FIRMWARE), f"BUILD={build}", target], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


class Chip:
    """The firmware on the emulated chip; see hw/virtual_rig/README.md. Time is in cycles of its clock."""

    def __init__(self, build: Path) -> None:
        self.process = subprocess.Popen(
            [str(build / "emulator"), str(build / "firmware.elf")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.cycle = 0
        self.edges: list[tuple[int, str, int]] = []
        """(cycle, pin, level) of all outputs."""
        self.inputs: list[tuple[int, str, int]] = []
        """(cycle, pin, level) of all inputs set by `pin`."""
        self.sent: list[tuple[int, bytes]] = []
        """What the firmware sent, with the cycle of the first byte; to be taken by the reader."""
        self.resets: list[int] = []

    def do(self, command: str) -> None:
        """Execute one command and record its output."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        word, *rest = command.split()
        if word == "pin":
            self.inputs.append((self.cycle, rest[0], int(rest[1])))
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        for line in self.process.stdout:
            word, *rest = line.split()
            if word == "edge":
                self.edges.append((int(rest[0]), rest[1], int(rest[2])))
            elif word == "sent":
                self.sent.append((int(rest[0]), bytes.fromhex(rest[1])))
            elif word == "reset":
                self.resets.append(int(rest[0]))
            elif word == "ok":
                self.cycle = int(rest[0])
                return
            else:
                assert word == "Loaded", line  # simavr lists the sections
        pytest.fail(f"the emulator ended with {self.process.wait()} at {command!r}")

    def run_ms(self, ms: float) -> None:
        self.do(f"run {round(ms * 1000 * CYCLES_PER_US)}")

    def take(self) -> bytes:
        data = b"".join(data for _, data in self.sent)
        self.sent.clear()
        return data

    def rises(self, pin: str) -> list[int]:
        return [cycle for cycle, name, level in self.edges if name == pin and level]

    def widths(self, pin: str) -> list[int]:
        """Of all complete pulses on a pin, in cycles."""
        edges = [(cycle, level) for cycle, name, level in self.edges if name == pin]
        assert [level for _, level in edges] == [1 - k % 2 for k in range(len(edges))]
        return [b - a for (a, _), (b, _) in zip(edges[::2], edges[1::2], strict=False)]

    def close(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        assert self.process.wait(10) == 0
