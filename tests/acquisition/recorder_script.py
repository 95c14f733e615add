"""Scripted pulses and frames for the recorder: devices with clocks of their own, events given in host time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import count

from vaoi_station.acquisition.cameras.interface import Arrival
from vaoi_station.acquisition.clocks import ClockModel, ClockReading, DeviceClock
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.evidence import MAX_FRAME_ID
from vaoi_station.acquisition.pairing.latency import LatencySettings
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.recorder import Finished, Outcome, Recorder, Settled, Unassigned
from vaoi_station.model import FrameRecord, Verdict

PERIOD_S = 0.1

Event = Callable[[float], Iterable[Outcome]]
"""Called with the host time at which it happens."""


def clock_model(true: DeviceClock) -> ClockModel:
    """Return the model of a clock after readings that span all scripts."""
    model = ClockModel("device")
    for at_s in (-2.0, -1.0, 0.0, 10.0, 20.0):
        model.add(ClockReading(true.device_s(1000.0 + at_s), 1000.0 + at_s, 1e-4))
    return model


@dataclass
class RecorderScript:
    """Plays timed events into a recorder, and calls it at all deadlines in between."""

    cameras: int
    latencies: Sequence[LatencySettings] = ()
    shutters_us: Sequence[float] = ()
    controller: DeviceClock = field(default_factory=lambda: DeviceClock(7e5, 40.0, origin_s=1000.0))
    outcomes: list[Outcome] = field(default_factory=list)
    events: list[tuple[float, int, Event]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.camera_clocks = [DeviceClock(-50.0 * n, 30.0 - 25.0 * n, origin_s=1000.0) for n in range(self.cameras)]
        models = [clock_model(c) for c in self.camera_clocks]
        self.recorder = Recorder(
            clock_model(self.controller), models, exposures_us=self.shutters_us, latencies=self.latencies
        )
        # The first ids are near the wrap of 16 bit ids, so that some scripts cross it.
        self._order, self._slots, self._ids = count(), count(), [count(65400) for _ in range(self.cameras)]
        self.truth: dict[int, tuple[str | None, int, int]] = {}
        """slot → (run, camera, row) of the frame in it; row −1: of no pulse."""

    def at(self, host_s: float, event: Event) -> None:
        """Schedule an event."""
        heapq.heappush(self.events, (host_s, next(self._order), event))

    def run(
        self, name: str | None, first_s: float, rows: int, report_delay_s: float, on_us: Sequence[float] = ()
    ) -> None:
        """Schedule the pulses of a run from `first_s` on; each is reported `report_delay_s` later.

        The LEDs are on for `on_us` of the row, in turn; the controller does not report it if there is none.
        """

        def pulse(row: int) -> Event:
            def event(now_s: float) -> Iterable[Outcome]:
                if row == 0:
                    self.recorder.begin_run(name, None if name is None else 0, PERIOD_S)
                time_s = self.controller.device_s(first_s + row * PERIOD_S)
                lit_us = on_us[row % len(on_us)] if on_us else None
                return self.recorder.add_pulse(PulseFired(0, time_s, row, "ring", on_us=lit_us), now_s)

            return event

        def end(now_s: float) -> Iterable[Outcome]:
            record = next(r for r in self.recorder.open_runs if r.run == name and r.pulse_count is None)
            return self.recorder.end_pulses(record, rows, "clear", now_s)

        for row in range(rows):
            self.at(first_s + row * PERIOD_S + report_delay_s, pulse(row))
        self.at(first_s + (rows - 1) * PERIOD_S + report_delay_s, end)

    def frame(
        self,
        of: tuple[str | None, int, int],
        exposed_s: float,
        latency_s: float,
        *,
        complete: bool = True,
        dated_s: float | None = None,
        frame_id: int | None = None,
    ) -> None:
        """Schedule a frame that arrives `latency_s` after its exposure, by default with its own time stamp and id."""
        slot, camera = next(self._slots), of[1]
        self.truth[slot] = of
        counted = next(self._ids[camera]) if frame_id is None else frame_id
        number = (counted - 1) % MAX_FRAME_ID + 1
        stamp_s = self.camera_clocks[camera].device_s((exposed_s if dated_s is None else dated_s) + 7e-6)

        def event(now_s: float) -> Iterable[Outcome]:
            if complete:
                return self.recorder.add_arrival(Arrival(camera, slot, True, number, stamp_s, now_s), now_s)
            return self.recorder.add_arrival(Arrival(camera, slot, False, None, None, now_s, "packets lost"), now_s)

        self.at(exposed_s + latency_s, event)

    def skip_id(self, camera: int) -> int:
        """Count a frame that never arrives; the returned id may be given to another one."""
        return next(self._ids[camera])

    def play(self) -> None:
        """Play all events in the order of time, with the recorder's deadlines in between."""
        now_s = 0.0
        while True:
            deadline_s = self.recorder.next_deadline_s(now_s)
            if self.events and (deadline_s is None or self.events[0][0] <= deadline_s):
                now_s, _, event = heapq.heappop(self.events)
                self.outcomes += event(now_s)
            elif deadline_s is not None:
                now_s = deadline_s
                self.outcomes += self.recorder.settle(now_s)
            else:
                return

    @property
    def finished(self) -> dict[str | None, tuple[FrameRecord, ...]]:
        """Frames of every finished run."""
        return {o.record.run: o.frames for o in self.outcomes if isinstance(o, Finished)}

    @property
    def proofs(self) -> dict[str | None, TriggerProof]:
        """Proof of every finished run."""
        return {o.record.run: o.proof for o in self.outcomes if isinstance(o, Finished)}

    @property
    def unassigned(self) -> list[Unassigned]:
        """Unassigned frames in the order of their outcomes."""
        return [o for o in self.outcomes if isinstance(o, Unassigned)]

    def verdicts(self, run: str) -> dict[tuple[int, int], Verdict]:
        """Return (camera, row) → verdict of a run."""
        return {(f.camera, f.row): f.verdict for f in self.finished[run]}

    def wrong_rows(self, run: str) -> list[tuple[int, int]]:
        """Return every (camera, row) of a run that is accepted as good with the frame of another row."""
        return [
            (f.camera, f.row)
            for f in self.finished[run]
            if f.usable and f.slot is not None and self.truth[f.slot] != (run, f.camera, f.row)
        ]

    def ambiguous(self, run: str | None, camera: int) -> bool:
        """Whether the proof of a run says that the frames of a camera may be in wrong rows."""
        return any(f.camera == camera and f.kind == "latency-ambiguous" for f in self.proofs[run].findings)

    def check(self) -> None:
        """Assert what holds for every script."""
        for run, frames in self.finished.items():
            for frame in frames:
                if frame.slot is not None and not self.ambiguous(run, frame.camera):
                    assert self.truth[frame.slot] == (run, frame.camera, frame.row)
                assert bool(frame.cause) or frame.verdict is Verdict.OK
                assert (frame.slot is None) == (frame.verdict is Verdict.MISSING)
        self.check_slots()

    def check_slots(self) -> None:
        """Assert that no slot is lost and none is returned twice."""
        settled = [o.frame.slot for o in self.outcomes if isinstance(o, Settled) and o.frame.slot is not None]
        returned = sorted([*settled, *(o.slot for o in self.unassigned)])
        assert returned == sorted(self.truth), "every slot is returned exactly once"
