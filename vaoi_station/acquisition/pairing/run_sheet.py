"""What is known of one run while it is filmed: its pulses, and which frames have found theirs."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

from vaoi_station.acquisition.pairing.records import KnownPulse, Seen
from vaoi_station.model import FrameRecord


@dataclass
class RunSheet:
    """One run; `run` is None for a board nobody has memory for, whose frames are recognised all the same."""

    run: str | None
    bay: int | None
    period_s: float
    pulses: dict[int, KnownPulse] = field(default_factory=dict)
    skipped: dict[int, str] = field(default_factory=dict)
    """Row → why the controller did not fire it."""
    frames: dict[tuple[int, int], FrameRecord] = field(default_factory=dict)
    """(camera, row) → its verdict; final once set."""
    taken: set[tuple[int, int]] = field(default_factory=set)
    """(camera, row) whose frame has arrived."""
    seen: defaultdict[int, list[Seen]] = field(default_factory=lambda: defaultdict(list))
    """Camera → its whole frames."""
    refused: dict[tuple[int, int], str] = field(default_factory=dict)
    """(camera, row) whose frame came and could not be kept, and why."""
    strays: int = 0
    last_frame_host_s: float | None = None
    pulse_count: int | None = None
    """Pulses of the whole run; None while it goes on."""
    reason: str = ""
    deadline_s: float = float("inf")
    """Host time until which late frames are waited for."""
    finished: bool = False

    @property
    def rows(self) -> int:
        """Rows known so far."""
        return max(self.pulse_count or 0, 1 + max(self.pulses, default=-1))

    @property
    def shortest_interval_s(self) -> float:
        """The closest that two pulses came."""
        times = sorted(p.host_s for p in self.pulses.values())
        return min((b - a for a, b in pairwise(times)), default=self.period_s)

    def nearest(self, host_s: float) -> tuple[int, float] | None:
        """Row of the pulse nearest to a host time, and host_s minus the pulse's."""
        if not self.pulses:
            return None
        row = min(self.pulses, key=lambda r: abs(self.pulses[r].host_s - host_s))
        return row, host_s - self.pulses[row].host_s

    def open_rows(self, camera: int) -> list[int]:
        """Rows of a camera that were fired and have no frame yet (or never got one)."""
        return [r for r in range(self.rows) if (camera, r) not in self.taken and r not in self.skipped]

    def lights(self) -> tuple[str, ...] | None:
        """Light pattern of every row; None where none has a name."""
        names = tuple(self.pulses[r].pulse.light if r in self.pulses else "" for r in range(self.rows))
        return names if any(names) else None

    def exposures_us(self) -> tuple[tuple[float, ...], ...] | None:
        """Exposures of every row, where the controller told them for all."""
        rows = [self.pulses[r].exposures_us if r in self.pulses else () for r in range(self.rows)]
        return tuple(rows) if all(rows) else None

    def times_s(self) -> tuple[float, ...]:
        """Pulse times by the controller, relative to the first, rounded to ns; lost reports are interpolated."""
        known = {r: p.pulse.time_s for r, p in self.pulses.items()}
        first = min(known)
        times = {r: t - known[first] for r, t in known.items()}
        for row in range(self.rows):
            if row not in times:
                times[row] = times[row - 1] + self.period_s if row else min(times.values()) - self.period_s * first
        zero = times[0]
        return tuple(round(times[r] - zero, 9) for r in range(self.rows))
