"""The record of one run during filming: the pulses that were reported, and the frames assigned to them."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from vaoi_station.acquisition.cameras.interface import StatedExposure
from vaoi_station.acquisition.controller.interface import PulseFired, PulseSkipped
from vaoi_station.line_config import row_ways_mm
from vaoi_station.model import FrameRecord, ProgramRow
from vaoi_station.model.recording import row_of


@dataclass(frozen=True)
class ObservedPulse:
    """A pulse as the controller reported it, with its time on the host's clock and when the report came."""

    event: PulseFired
    host_s: float
    reported_s: float = math.inf


@dataclass(frozen=True)
class ObservedFrame:
    """A complete frame with its frame id and times, as the proof uses them."""

    row: int | None
    frame_id: int | None
    time_s: float
    host_s: float
    arrived_s: float
    epoch: int = 0
    """Number of the camera's outages before this frame. Frames of one epoch have the same clock and frame counter."""
    stated: StatedExposure | None = None


Interruption = tuple[float, float | None]
"""Times at which the barrier was interrupted and clear again; None if it was not clear when the run ended."""


@dataclass
class RunRecord:
    """The pulses and frames of one run, collected while the run is filmed.

    `run` and `bay` are None for a board that was missed because no memory was free. Its frames are recognised and
    discarded.
    """

    run: str | None
    bay: int | None
    period_s: float
    pulses: dict[int, ObservedPulse] = field(default_factory=dict)
    skipped: dict[int, PulseSkipped] = field(default_factory=dict)
    frames: dict[tuple[int, int], FrameRecord] = field(default_factory=dict)
    """(camera, row) → record of its frame with the verdict, which is final."""
    taken: set[tuple[int, int]] = field(default_factory=set)
    """Every (camera, row) of which a frame has arrived."""
    complete_frames: defaultdict[int, list[ObservedFrame]] = field(default_factory=lambda: defaultdict(list))
    refused: dict[tuple[int, int], str] = field(default_factory=dict)
    unassigned: int = 0
    last_frame_host_s: float | None = None
    pulse_count: int | None = None
    """Count of rows of the whole run, including skipped ones; None until the end of the pulses is reported."""
    reason: str = ""
    deadline_s: float = math.inf
    """Host time until which late frames are awaited."""
    finished: bool = False
    doubted: frozenset[int] = frozenset()
    """Cameras whose frames are in doubt; a reading of their clocks may show that a jump of the clock is the cause."""
    latency_known: dict[int, bool] = field(default_factory=dict)
    """For each camera whose latency was learnt from this run: whether the beginning of the run confirms the latency."""

    silent: frozenset[int] = frozenset()
    """Cameras of which not one packet had arrived when the pulses ended, although they answer requests."""
    interruptions: list[Interruption] = field(default_factory=list)
    program: tuple[ProgramRow, ...] = ()
    """What the rows should be filmed with, in turn; empty without a light program."""
    conveyor_mm_s: tuple[float, float] | None = None
    row_mm: float | None = None
    shutters_us: tuple[float, ...] = ()
    fastest_s: float = math.inf
    """Shortest time between two pulses that the plan of the run allows; infinite without a plan."""

    @property
    def first_s(self) -> float:
        """Host time of the earliest pulse that was reported."""
        return min(p.host_s for p in self.pulses.values())

    @property
    def has_first_pulse(self) -> bool:
        """Whether the first pulse that was fired has been reported."""
        return bool(self.pulses) and all(row in self.skipped for row in range(min(self.pulses)))

    @property
    def all_fired(self) -> bool:
        """Whether all pulses were fired and reported."""
        return self.pulse_count is not None and len(self.pulses) == self.pulse_count - len(self.skipped)

    @property
    def rows(self) -> int:
        """The number of rows that are known so far."""
        return max(self.pulse_count or 0, 1 + max(self.pulses, default=-1))

    @property
    def shortest_interval_s(self) -> float:
        """Shortest time between two pulses; the trigger period if there are fewer than two pulses."""
        times = sorted(p.host_s for p in self.pulses.values())
        return min((b - a for a, b in pairwise(times)), default=self.period_s)

    @property
    def measured_period_s(self) -> float:
        """The trigger period, or the shortest time between two reported pulses if the belt brought one sooner."""
        return min(self.period_s, self.shortest_interval_s)

    @property
    def least_period_s(self) -> float:
        """The shortest time between two pulses of this run, also of those that are not reported yet."""
        return min(self.measured_period_s, self.fastest_s)

    def nearest(self, host_s: float) -> tuple[int, float] | None:
        """Return the row of the pulse nearest to `host_s`, and `host_s` minus the pulse time; None without a pulse."""
        if not self.pulses:
            return None
        row = min(self.pulses, key=lambda r: abs(self.pulses[r].host_s - host_s))
        return row, host_s - self.pulses[row].host_s

    def latency_s(self, frame: ObservedFrame) -> float:
        """Return the time from the pulse of an assigned frame's row to its time stamp."""
        assert frame.row is not None
        return frame.host_s - self.pulses[frame.row].host_s

    def last_arrival_s(self, camera: int) -> float:
        """Return the host time at which the last complete frame of a camera arrived; minus infinity without one."""
        return max((frame.arrived_s for frame in self.complete_frames[camera]), default=-math.inf)

    def open_rows(self, camera: int) -> list[int]:
        """Return the rows of which no frame of this camera has arrived. Rows without a pulse are left out."""
        return [r for r in range(self.rows) if (camera, r) not in self.taken and r not in self.skipped]

    def awaits_frames(self, cameras: int) -> bool:
        """Return whether pulses may still be fired, or a frame of a pulse that was fired has not arrived."""
        return self.pulse_count is None or any(self.open_rows(camera) for camera in range(cameras))

    def lights(self) -> tuple[str, ...] | None:
        """Return the name of each row's light pattern; None if no pattern has a name."""
        names = []
        for row in range(self.rows):
            expected, pulse = row_of(self.program, row), self.pulses.get(row)
            names.append(pulse.event.light if pulse is not None else expected.light if expected is not None else "")
        return tuple(names) if any(names) else None

    def exposures_us(self) -> tuple[tuple[float, ...], ...] | None:
        """Return the exposures (µs) of every row, one per camera; None if no row, or not every row, has them."""
        # Where a row has no report, the shutters limit its exposure, if they are known.
        reported = [self.taken_with(r)[0] for r in range(self.rows)]
        rows = tuple(row or self.shutters_us for row in reported)
        return rows if any(reported) and all(rows) else None

    def gains(self) -> tuple[tuple[float, ...], ...] | None:
        """Return the linear gains of every row, one per camera; None unless all rows have a report of them."""
        rows = [self.taken_with(r)[1] for r in range(self.rows)]
        return tuple(rows) if all(rows) else None

    def taken_with(self, row: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return exposures (µs) and linear gains of all cameras in a row: as reported, else as the program states.

        Without a program, LEDs that are on for a shorter time than a shutter is open determine the exposures. Both are
        empty if they are those of station.toml, or unknown.
        """
        expected, event = row_of(self.program, row), self.pulses[row].event if row in self.pulses else None
        exposures_us, gains, on_us = (
            (event.exposures_us, event.gains, event.on_us) if event is not None else ((), (), 0)
        )
        if expected is not None:
            return exposures_us or expected.lit_us, gains or expected.gains
        # An on-time of 0 is that of a row under a light without LEDs of the controller.
        if not exposures_us and on_us and on_us < max(self.shutters_us, default=0.0):
            return tuple(min(shutter_us, on_us) for shutter_us in self.shutters_us), gains
        return exposures_us, gains

    def times_s(self) -> tuple[float, ...]:
        """Return every row's pulse time by the controller's clock, relative to row 0 and rounded to ns.

        A pulse whose report was lost is placed between its neighbours; beyond them rows follow at the interval there.
        """
        times = self._row_times_s()
        return tuple(round(times[r] - times[0], 9) for r in range(self.rows))

    def belt_mm(self) -> tuple[float, ...] | None:
        """Return the belt's way at each row since row 0; None without an encoder. Skipped rows have their place."""
        return None if self.row_mm is None else row_ways_mm(self.row_mm, self.rows)

    def interruptions_s(self) -> tuple[Interruption, ...]:
        """Return the interruptions of the barrier, relative to row 0 and rounded to ns."""
        zero_s = self._row_times_s()[0]
        return tuple(
            (round(blocked_s - zero_s, 9), None if clear_s is None else round(clear_s - zero_s, 9))
            for blocked_s, clear_s in self.interruptions
        )

    def _row_times_s(self) -> list[float]:
        # The belt may space the rows, so that the trigger period is no measure of their intervals.
        known_s = self._known_times_s()
        rows, times_s = list(known_s), list(known_s.values())
        first_s = last_s = self.period_s
        if len(rows) > 1:
            first_s, last_s = ((times_s[k + 1] - times_s[k]) / (rows[k + 1] - rows[k]) for k in (0, -2))
        # `interp` returns the first or the last known time for rows beyond them.
        within_s = np.interp(range(self.rows), rows, times_s).tolist()
        return [
            time_s + min(row - rows[0], 0) * first_s + max(row - rows[-1], 0) * last_s
            for row, time_s in enumerate(within_s)
        ]

    def _known_times_s(self) -> dict[int, float]:
        times_s = {row: pulse.event.time_s for row, pulse in self.pulses.items()}
        for row, event in sorted(self.skipped.items()):
            before_s = max((s for r, s in times_s.items() if r < row), default=-math.inf)
            after_s = min((s for r, s in times_s.items() if r > row), default=math.inf)
            if row < self.rows and row not in times_s and before_s < event.time_s < after_s:
                times_s[row] = event.time_s
        return dict(sorted(times_s.items()))
