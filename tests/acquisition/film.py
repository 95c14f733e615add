"""Stories for the recorder: devices with clocks of their own, told in host time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import count

from vaoi_station.acquisition.cameras.interface import Arrival
from vaoi_station.acquisition.causes import WRAP
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.recorder import Finished, Limits, Outcome, Recorder, Settled, Stray
from vaoi_station.model import FrameRecord, Verdict

PERIOD_S = 0.1
LIMITS = Limits()


def clock_model(true: DeviceClock) -> ClockModel:
    model = ClockModel("device")
    for at_s in (-2.0, -1.0, 0.0, 10.0, 20.0):
        model.add(ClockReading(true.device_s(1000.0 + at_s), 1000.0 + at_s, 1e-4))
    return model


@dataclass
class Film:
    """Plays a story of host-timed happenings into a recorder, with all deadlines in between."""

    cameras: int
    controller: DeviceClock = field(default_factory=lambda: DeviceClock(7e5, 40.0, origin_s=1000.0))
    outcomes: list[Outcome] = field(default_factory=list)
    story: list[tuple[float, int, Callable[[float], Iterable[Outcome]]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.camera_clocks = [DeviceClock(-50.0 * n, 30.0 - 25.0 * n, origin_s=1000.0) for n in range(self.cameras)]
        models = [clock_model(c) for c in self.camera_clocks]
        self.recorder = Recorder(clock_model(self.controller), models, LIMITS)
        self._order, self._slots, self._ids = count(), count(), [count(65400) for _ in range(self.cameras)]
        self.truth: dict[int, tuple[str | None, int, int]] = {}
        """slot → (run, camera, row) of the frame in it; row −1: of no pulse."""

    def at(self, host_s: float, happening: Callable[[float], Iterable[Outcome]]) -> None:
        heapq.heappush(self.story, (host_s, next(self._order), happening))

    def run(self, name: str | None, first_s: float, rows: int, lag_s: float) -> None:
        """Pulses from `first_s` on; the host hears of each `lag_s` later."""

        def pulse(row: int) -> Callable[[float], Iterable[Outcome]]:
            def happen(now_s: float) -> Iterable[Outcome]:
                if row == 0:
                    self.recorder.begin(name, None if name is None else 0, PERIOD_S)
                time_s = self.controller.device_s(first_s + row * PERIOD_S)
                return self.recorder.pulse(PulseFired(0, time_s, row, "ring"), now_s)[1]

            return happen

        def end(now_s: float) -> Iterable[Outcome]:
            sheet = next(s for s in self.recorder.open_runs if s.run == name and s.pulse_count is None)
            return self.recorder.end(sheet, rows, "clear", now_s)

        for row in range(rows):
            self.at(first_s + row * PERIOD_S + lag_s, pulse(row))
        self.at(first_s + (rows - 1) * PERIOD_S + lag_s, end)

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
        """A frame exposed at a host time, and handed over `latency_s` later; maybe with another's date and id."""
        slot, camera = next(self._slots), of[1]
        self.truth[slot] = of
        counted = next(self._ids[camera]) if frame_id is None else frame_id
        number = (counted - 1) % WRAP + 1
        stamp_s = self.camera_clocks[camera].device_s((exposed_s if dated_s is None else dated_s) + 7e-6)

        def happen(now_s: float) -> Iterable[Outcome]:
            if complete:
                return self.recorder.arrive(Arrival(camera, slot, True, number, stamp_s, now_s), now_s)
            return self.recorder.arrive(Arrival(camera, slot, False, None, None, now_s, "torn"), now_s)

        self.at(exposed_s + latency_s, happen)

    def skip_id(self, camera: int) -> int:
        """The camera counts a frame that is never handed over (or is to be handed over under this id)."""
        return next(self._ids[camera])

    def play(self) -> None:
        """Everything in the order of time; deadlines as the process would meet them."""
        now_s = 0.0
        while True:
            deadline_s = self.recorder.next_deadline_s(now_s)
            if self.story and (deadline_s is None or self.story[0][0] <= deadline_s):
                now_s, _, happen = heapq.heappop(self.story)
                self.outcomes += happen(now_s)
            elif deadline_s is not None:
                now_s = deadline_s
                self.outcomes += self.recorder.settle(now_s)
            else:
                return

    @property
    def finished(self) -> dict[str | None, tuple[FrameRecord, ...]]:
        return {o.sheet.run: o.frames for o in self.outcomes if isinstance(o, Finished)}

    @property
    def proofs(self) -> dict[str | None, TriggerProof]:
        return {o.sheet.run: o.proof for o in self.outcomes if isinstance(o, Finished)}

    @property
    def strays(self) -> list[Stray]:
        return [o for o in self.outcomes if isinstance(o, Stray)]

    def verdicts(self, run: str) -> dict[tuple[int, int], Verdict]:
        return {(f.camera, f.row): f.verdict for f in self.finished[run]}

    def check(self) -> None:
        """What must always hold."""
        for run, frames in self.finished.items():
            for frame in frames:
                if frame.slot is not None:
                    assert self.truth[frame.slot] == (run, frame.camera, frame.row)
                assert bool(frame.cause) or frame.verdict is Verdict.OK
                assert (frame.slot is None) == (frame.verdict is Verdict.MISSING)
        self.check_accounts()

    def check_accounts(self) -> None:
        """No slot is lost, and none comes back twice."""
        settled = [o.frame.slot for o in self.outcomes if isinstance(o, Settled) and o.frame.slot is not None]
        accounted = sorted([*settled, *(s.slot for s in self.strays)])
        assert accounted == sorted(self.truth), "every slot comes back exactly once"
