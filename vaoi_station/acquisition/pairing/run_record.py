"""The state of one run while it is filmed: the observed pulses, and the frames assigned to them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

from vaoi_station.model import FrameRecord, Pulse


@dataclass(frozen=True)
class ObservedPulse:
    """A pulse that the controller reported."""

    pulse: Pulse
    host_s: float
    """Host time at which it was fired."""
    exposures_us: tuple[float, ...] = ()
    """Exposure of every camera; empty where the controller does not report them."""
    reported_s: float = float("inf")
    """Host time at which the controller's report of it was received."""


@dataclass(frozen=True)
class ObservedFrame:
    """A complete frame."""

    row: int | None
    """The row it is assigned to; None for an unassigned frame."""
    frame_id: int | None
    time_s: float
    """Time stamp by the camera's clock."""
    host_s: float
    """The time stamp on the host's clock."""
    arrived_s: float
    """Host time of its arrival."""
    epoch: int = 0
    """Count of outages of its camera before it. Frames of one epoch share one clock and one frame counter."""


@dataclass
class RunRecord:
    """One run; `run` is None for a missed board without memory, whose frames are recognised and discarded."""

    run: str | None
    bay: int | None
    period_s: float
    pulses: dict[int, ObservedPulse] = field(default_factory=dict)
    """Row → its pulse."""
    skipped: dict[int, str] = field(default_factory=dict)
    """Row → why the controller did not fire it."""
    frames: dict[tuple[int, int], FrameRecord] = field(default_factory=dict)
    """(camera, row) → its verdict; final once set."""
    taken: set[tuple[int, int]] = field(default_factory=set)
    """(camera, row) whose frame has arrived."""
    complete_frames: defaultdict[int, list[ObservedFrame]] = field(default_factory=lambda: defaultdict(list))
    """Camera → its complete frames."""
    refused: dict[tuple[int, int], str] = field(default_factory=dict)
    """(camera, row) → why its frame arrived and could not be kept."""
    unassigned: int = 0
    """Count of frames that belong to no pulse."""
    last_frame_host_s: float | None = None
    """Host time of the latest arrival."""
    pulse_count: int | None = None
    """Pulses of the whole run; None while it goes on."""
    reason: str = ""
    """Why the pulses ended: see `controller.interface.RunEnded`."""
    deadline_s: float = float("inf")
    """Host time until which late frames are awaited."""
    finished: bool = False

    @property
    def rows(self) -> int:
        """Rows known by now."""
        return max(self.pulse_count or 0, 1 + max(self.pulses, default=-1))

    @property
    def shortest_interval_s(self) -> float:
        """Shortest time between two pulses; the period for fewer than two."""
        times = sorted(p.host_s for p in self.pulses.values())
        return min((b - a for a, b in pairwise(times)), default=self.period_s)

    def nearest(self, host_s: float) -> tuple[int, float] | None:
        """Return the row of the pulse nearest to a host time, and host_s minus the pulse's; None without a pulse."""
        if not self.pulses:
            return None
        row = min(self.pulses, key=lambda r: abs(self.pulses[r].host_s - host_s))
        return row, host_s - self.pulses[row].host_s

    def open_rows(self, camera: int) -> list[int]:
        """Return the fired rows of a camera of which no frame has arrived."""
        return [r for r in range(self.rows) if (camera, r) not in self.taken and r not in self.skipped]

    def lights(self) -> tuple[str, ...] | None:
        """Return the light pattern of every row; None if no pattern has a name."""
        names = tuple(self.pulses[r].pulse.light if r in self.pulses else "" for r in range(self.rows))
        return names if any(names) else None

    def exposures_us(self) -> tuple[tuple[float, ...], ...] | None:
        """Return the exposures of every row; None unless the controller reported them for all rows."""
        rows = [self.pulses[r].exposures_us if r in self.pulses else () for r in range(self.rows)]
        return tuple(rows) if all(rows) else None

    def times_s(self) -> tuple[float, ...]:
        """Return the pulse times by the controller's clock, relative to the first and rounded to ns.

        A pulse whose report was lost is placed one period after the pulse before it.
        """
        known = {r: p.pulse.time_s for r, p in self.pulses.items()}
        first = min(known)
        times = {r: t - known[first] for r, t in known.items()}
        for row in range(self.rows):
            if row not in times:
                times[row] = times[row - 1] + self.period_s if row else min(times.values()) - self.period_s * first
        zero = times[0]
        return tuple(round(times[r] - zero, 9) for r in range(self.rows))
