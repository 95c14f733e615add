"""The controller's firmware on an emulated chip: build it, run it, and decode the edges of its pins."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.rig.device_process import DeviceProcess
from vaoi_station.version import __version__

_HERE = Path(__file__).resolve()
PACKAGED = _HERE.parent / "hardware" / "firmware"
"""Folder of the firmware's sources in an installed package; see `force-include` in pyproject.toml."""
CHECKOUT = _HERE.parents[2] / "hw" / "firmware"
_TOOLS = {"make": "make", "gcc": "gcc", "avr-gcc": "gcc-avr avr-libc"}
"""Build tool → the packages of the Linux distribution that contain it."""


def find_sources() -> Path:
    """Return the folder with the firmware's Makefile, in the installed package or in the checkout."""
    # PACKAGED comes first: for an installed package, the folder at CHECKOUT may belong to another project.
    for folder in (PACKAGED, CHECKOUT):
        if (folder / "Makefile").is_file():
            return folder
    raise NotFoundError(
        f"the rig runs the real firmware, but its sources are neither in {PACKAGED} nor in {CHECKOUT}.",
        action=f"Install version {__version__} again from its wheel, or run it from a checkout.",
    )


def check_sources() -> None:
    """Check that this computer can build the firmware. Called first, because rendering boards takes minutes."""
    find_sources()
    if missing := [packages for tool, packages in _TOOLS.items() if shutil.which(tool) is None]:
        action = f"Install the distribution's packages {' '.join(missing)} libsimavr-dev libelf-dev."
        raise DeviceError("the firmware cannot be built here.", action=action)


def build(folder: Path) -> Path:
    """Build the firmware and the emulator into a folder. The folder of the sources is not written."""
    check_sources()
    sources = find_sources()
    command = ["make", "-C", str(sources), f"BUILD={folder.resolve()}", "all", "emulator"]
    if sources == PACKAGED:
        # The Makefile asks git for the commit. For a package inside another repository, git would give a wrong commit.
        command.append("COMMIT=")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceError(f"the firmware does not build: {(done.stderr or done.stdout).strip()[-1000:]}")
    return folder


HZ = 16_000_000
NS_PER_CYCLE = 62.5


@dataclass(frozen=True)
class Edge:
    """A change of the level of one output pin of the chip."""

    cycle: int
    pin: str
    level: bool
    host_ns: int
    """Time of the chip's cycle in which the level changed, ns of CLOCK_MONOTONIC."""


class Chip(DeviceProcess):
    """The running emulator of the chip. It keeps pace with CLOCK_MONOTONIC, so that each cycle has a host time."""

    def __init__(
        self, built: Path, terminal: Path, on_edge: Callable[[Edge], None], on_reset: Callable[[], None] = lambda: None
    ) -> None:
        """Prepare the emulator, which creates the link `terminal` as the controller's serial port."""
        super().__init__("the emulated chip", [f"{built}/emulator", f"{built}/firmware.elf", "--pty", str(terminal)])
        self.terminal = terminal
        self._on_edge, self._on_reset = on_edge, on_reset
        self._origin: tuple[int, int] = (0, 0)

    def cycle_at(self, host_ns: int) -> int:
        """Return the chip's cycle at a time in ns of CLOCK_MONOTONIC."""
        cycle, ns = self._origin
        return cycle + round((host_ns - ns) / NS_PER_CYCLE)

    def host_ns(self, cycle: int) -> int:
        """Return the time of a cycle in ns of CLOCK_MONOTONIC."""
        first, ns = self._origin
        return ns + round((cycle - first) * NS_PER_CYCLE)

    def send(self, command: str) -> None:
        """Send one command line to the emulator (`hw/virtual_rig/README.md`); raise DeviceError if it has ended."""
        if not self.write(command):
            raise DeviceError("the emulated chip has ended.")

    def on_report(self, word: str, rest: list[str]) -> bool:
        """Pass on an edge or a reset, or take over the origin of the clock."""
        if word == "clock":
            # This line comes at the start and after each reset, when the emulator starts its clock again.
            self._origin = (int(rest[0]), int(rest[1]))
        elif word == "edge":
            cycle = int(rest[0])
            self._on_edge(Edge(cycle, rest[1], rest[2] == "1", self.host_ns(cycle)))
        elif word == "reset":
            self._on_reset()
        return word == "clock"


TRIGGER, GATE = "PB1", "PB2"
CHANNELS = ("PD4", "PD5", "PD6", "PD7")
CYCLES_PER_US = HZ / 1e6


@dataclass(frozen=True)
class Pulse:
    """One trigger pulse for all cameras."""

    cycle: int
    host_ns: int
    """Time of that cycle, ns of CLOCK_MONOTONIC."""
    channels: tuple[int, ...]
    """Indices of the LED channels that were on; empty: no light."""
    on_us: float
    """Time, µs, for which the LED channels were on after the trigger's rising edge."""
    width_us: float = 0.0


class PulseDecoder:
    """Decoder that takes edges one by one and returns pulses. It keeps the state of the pins between the edges."""

    def __init__(self) -> None:
        self._high: dict[str, Edge] = {}
        self._trigger: Edge | None = None
        """Rising edge of the trigger whose pulse is not complete; None: no pulse has begun."""
        self._fallen: Edge | None = None
        self._gate: Edge | None = None
        self._lit: tuple[int, ...] = ()
        self._on_us = 0.0

    def process(self, edge: Edge) -> Pulse | None:
        """Process the next edge, in the order of cycles. Return a pulse if this edge completes one."""
        if edge.level:
            self._high[edge.pin] = edge
        else:
            self._high.pop(edge.pin, None)
        if edge.pin == TRIGGER and edge.level:
            self._trigger, self._fallen, self._on_us = edge, None, 0.0
        elif edge.pin == GATE and edge.level:
            self._gate = edge
            # The firmware sets the channels before it opens the gate, so they are complete here.
            self._lit = tuple(n for n, pin in enumerate(CHANNELS) if pin in self._high)
        elif edge.pin == TRIGGER:
            self._fallen = edge
            return self._complete()
        elif edge.pin == GATE:
            gate, self._gate = self._gate, None
            if gate is not None and self._trigger is not None:
                # Light before the trigger's rising edge is not counted, because the exposure starts at this edge.
                self._on_us = (edge.cycle - max(gate.cycle, self._trigger.cycle)) / CYCLES_PER_US
            return self._complete()
        return None

    def _complete(self) -> Pulse | None:
        """Return the pulse if the trigger and the gate have fallen."""
        trigger, fallen, on_us = self._trigger, self._fallen, self._on_us
        if trigger is None or fallen is None or self._gate is not None:
            return None
        self._trigger = self._fallen = None
        width_us = (fallen.cycle - trigger.cycle) / CYCLES_PER_US
        return Pulse(trigger.cycle, trigger.host_ns, self._lit if on_us else (), on_us, width_us)
