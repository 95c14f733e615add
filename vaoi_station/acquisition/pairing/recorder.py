"""Assign one frame per camera to every pulse, by time, and end every run with a verdict for each (camera, row).

Pure logic. A frame belongs to the pulse nearest to its time stamp minus its camera's latency, both on the host's clock,
within a tolerance; the order of arrival never decides. Incomplete frames, whose stamps cannot be trusted, are assigned
by elimination.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import TypeVar

from vaoi_station.acquisition.cameras.interface import Arrival
from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.conclusion import Outages, cameras_in_doubt, conclude_run, judge_run
from vaoi_station.acquisition.pairing.latency import Latencies, LatencySettings
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse, RunRecord
from vaoi_station.model import FrameRecord, Verdict

T = TypeVar("T", bound=Hashable)


def assign_forced(candidates: Sequence[AbstractSet[T]]) -> dict[int, T]:
    """Give each candidate set that has only one possible element this element; return {index of the set: element}.

    If two sets are left with the same single element, neither of them gets it.
    """
    left = [set(c) for c in candidates]
    chosen: dict[int, T] = {}
    while True:
        single = {n: next(iter(c)) for n, c in enumerate(left) if len(c) == 1 and n not in chosen}
        claims = Counter(single.values())
        forced = {n: c for n, c in single.items() if claims[c] == 1}
        if not forced:
            return chosen
        chosen.update(forced)
        for n, c in enumerate(left):
            if n not in chosen:
                c -= set(forced.values())


MAX_UNASSIGNED = 256
"""Count of unassigned frames kept per camera. The proof of a run uses those from shortly before to shortly after it."""
STAMP_JITTER_S = 5e-5
"""Largest error of a time stamp itself, s; real jitter is about 10 µs."""
MAX_FINISHED = 4


EARLY_S = 0.010
"""An incomplete frame may seem to arrive before its pulse by up to this time, because of the errors of the clocks."""
LATE_S = 0.5
"""Frames are awaited for one period plus this time after the end of the pulses."""
REPORT_DELAY_S = 0.1
"""Longest time from a pulse to the controller's report of it."""
UNEXPLAINED_S = 5.0
"""Time after its arrival at which a frame without a pulse is given up. The controller fires for 3 s without a
connection to the host, and reports these pulses when the connection is back."""


@dataclass(frozen=True)
class Settled:
    """The outcome that one (camera, row) of a run has received its final verdict."""

    run: str
    frame: FrameRecord


@dataclass(frozen=True)
class Unassigned:
    """The outcome that a frame belongs to no (camera, row) of a run. Its slot is free again."""

    camera: int
    slot: int
    reason: str


@dataclass(frozen=True)
class Finished:
    """The outcome that a run is finished. `frames` lists every (camera, row), ordered by camera, then by row."""

    record: RunRecord
    frames: tuple[FrameRecord, ...]
    proof: TriggerProof


Outcome = Settled | Unassigned | Finished
MoveToBay = Callable[[int, int, int], int | None]
"""`move(slot, bay, camera)` moves a frame into its run's bay; returns its slot there, or None if no slot is free."""


class Recorder:
    """Assigns arriving frames to pulses, and settles the runs. It holds all runs that are open or finished recently."""

    def __init__(
        self,
        controller_clock: ClockModel,
        camera_clocks: Sequence[ClockModel],
        move_to_bay: MoveToBay = lambda slot, _bay, _camera: slot,
        exposures_us: Sequence[float] = (),
        latencies: Sequence[LatencySettings] = (),
        gains: Sequence[float] = (),
    ) -> None:
        self.outages = Outages()
        self._controller_clock = controller_clock
        self._camera_clocks = camera_clocks
        self._move_to_bay = move_to_bay
        self._exposures_us, self._gains = exposures_us, gains
        self._latencies = Latencies(latencies or [LatencySettings() for _ in camera_clocks], self._bound_s)
        self._runs: list[RunRecord] = []
        self._waiting: list[tuple[Arrival, float]] = []
        """Complete frames whose pulse is not known yet, with the host time of their exposure."""
        self._unassigned: list[deque[ObservedFrame]] = [deque(maxlen=MAX_UNASSIGNED) for _ in camera_clocks]
        self._undated: list[Arrival] = []
        """Incomplete frames without a row; their time stamps cannot be trusted."""
        self._known_until_s = -math.inf

    @property
    def open_runs(self) -> list[RunRecord]:
        """The runs that are not finished yet, oldest first."""
        return [r for r in self._runs if not r.finished]

    @property
    def awaits_clocks(self) -> bool:
        """Whether a run without further pulses is not finished, so that readings of the clocks should be taken now."""
        return any(r.pulse_count is not None for r in self.open_runs)

    def begin_run(self, run: str | None, bay: int | None, period_s: float) -> RunRecord:
        """Begin the run of a board. `run` and `bay` are None if there is no memory for its frames."""
        record = RunRecord(run, bay, period_s, shutters_us=tuple(self._exposures_us))
        self._runs.append(record)
        return record

    def note_controller_time(self, time_s: float) -> None:
        """Record that an event of controller time `time_s` was reported. All pulses before this time are then known."""
        self._known_until_s = max(self._known_until_s, self._controller_clock.host_s(time_s))

    def add_pulse(self, event: PulseFired, now_s: float) -> Iterator[Outcome]:
        """Add a pulse to the newest run. Frames that arrived before the report of the pulse may then be assigned."""
        self.note_controller_time(event.time_s)
        self._runs[-1].pulses[event.index] = ObservedPulse(event, self._controller_clock.host_s(event.time_s), now_s)
        return self.settle(now_s)

    def end_pulses(self, record: RunRecord, pulses: int, reason: str, now_s: float) -> Iterator[Outcome]:
        """Record that the last pulse of a run was fired. `pulses` is the number of its rows."""
        if record.pulse_count is None:
            record.pulse_count, record.reason = pulses, reason
            record.deadline_s = now_s + record.period_s + LATE_S
        return self.settle(now_s)

    def add_arrival(self, arrival: Arrival, now_s: float) -> Iterator[Outcome]:
        """Add a frame that a camera has delivered, and return the outcomes that follow from it."""
        if arrival.complete and arrival.time_s is not None:
            self._waiting.append((arrival, self._camera_clocks[arrival.camera].host_s(arrival.time_s)))
        else:
            # An incomplete GigE frame repeats an older id and time stamp (measured with Aravis 0.8.26).
            self._undated.append(arrival)
        return self.settle(now_s)

    def settle(self, now_s: float) -> Iterator[Outcome]:
        """Decide everything that can be decided at `now_s`; call this again at `next_deadline_s` or earlier.

        The iterator must be exhausted. It is lazy so that the caller reports the last frame of a run before its proof
        is computed.
        """
        yield from self._assign_waiting(now_s)
        for record in self.open_runs:
            yield from self._try_finish(record, now_s)
        # This comes after the runs, because only an incomplete frame that no open run can take is given up.
        yield from self._give_up_undated(now_s)
        finished = [r for r in self._runs if r.finished]
        for record in finished[:-MAX_FINISHED]:
            self._runs.remove(record)

    def next_deadline_s(self, after_s: float) -> float | None:
        """Return the next host time after `after_s` at which `settle` may decide something even without a new event."""
        times = [a.host_time_s + UNEXPLAINED_S for a, _ in self._waiting]
        times += [a.host_time_s + s for a in self._undated for s in (REPORT_DELAY_S, UNEXPLAINED_S)]
        times += [r.deadline_s for r in self.open_runs]
        return min((t for t in times if t > after_s), default=None)

    def _assign_waiting(self, now_s: float) -> list[Outcome]:
        for camera in {a.camera for a, _ in self._waiting if not self._latencies[a.camera].confirmed}:
            frames = [(s, self._is_aged(a, now_s)) for a, s in self._waiting if a.camera == camera]
            self._latencies.learn(camera, self._runs, frames, [f.host_s for f in self._unassigned[camera]], now_s)
        out: list[Outcome] = []
        waiting, self._waiting = self._waiting, []
        for arrival, host_s in waiting:
            outcome = self._assign(arrival, host_s, now_s)
            if outcome is None:
                self._waiting.append((arrival, host_s))
            else:
                out.append(outcome)
        return out

    def _assign(self, arrival: Arrival, host_s: float, now_s: float) -> Outcome | None:
        camera, latency = arrival.camera, self._latencies[arrival.camera]
        if self._latencies.awaits(self._runs, camera, host_s):
            return None
        pulse_s = host_s - latency.value_s
        near = [(abs(found[1]), n, *found) for n, r in enumerate(self._runs) if (found := r.nearest(pulse_s))]
        if near:
            distance_s, n, row, error_s = min(near)
            # No camera stamps a frame before its pulse: such a time stamp belongs to another pulse, or to none.
            after_s = error_s + latency.value_s
            possible = after_s >= 0 or after_s >= -self._bound_s(camera, host_s)
            if possible and distance_s <= self._gate_s(self._runs[n], camera):
                return self._take(self._runs[n], row, arrival, Verdict.OK, after_s)
        if pulse_s + latency.gate_s < self._known_until_s or self._is_aged(arrival, now_s):
            self._unassigned[camera].append(_observed(arrival, None, host_s))
            nearest = f"; the nearest one is {min(near)[0] * 1e3:.1f} ms away" if near else ""
            late = f", {latency.value_s * 1e3:.1f} ms (its camera's latency) before its time stamp"
            when = late if latency.value_s > latency.gate_s else ""
            return self._refuse(arrival, f"no pulse was fired at the time of its exposure{when}{nearest}")
        return None

    def _gate_s(self, record: RunRecord, camera: int) -> float:
        bounds_s = self._controller_clock.bound_s() + self._camera_clocks[camera].bound_s()
        # Beyond half the interval between two pulses, the neighbouring pulse would be nearer.
        return min(record.shortest_interval_s / 2, self._latencies[camera].gate_s + bounds_s)

    def _bound_s(self, camera: int, host_s: float) -> float:
        # The bound of a clock grows with the time since its newest reading. `_gate_s` may neglect this.
        clocks = (self._controller_clock, self._camera_clocks[camera])
        return STAMP_JITTER_S + sum(clock.bound_s(clock.device_s(host_s)) for clock in clocks)

    def _is_aged(self, arrival: Arrival, now_s: float) -> bool:
        return now_s >= arrival.host_time_s + UNEXPLAINED_S

    def _take(
        self, record: RunRecord, row: int, arrival: Arrival, verdict: Verdict, error_s: float | None = None
    ) -> Outcome:
        key = (arrival.camera, row)
        if key in record.taken:
            if error_s is not None:
                unassigned = _observed(arrival, None, record.pulses[row].host_s + error_s)
                self._unassigned[arrival.camera].append(unassigned)
            return self._refuse(arrival, f"camera {key[0]} has a frame of row {row} already", record)
        record.taken.add(key)
        if record.run is None or record.bay is None:
            return Unassigned(arrival.camera, arrival.slot, "its board was missed: there was no free memory for a run")
        if record.finished:
            return self._refuse(arrival, f"it belongs to row {row} of run {record.run}, which is finished")
        slot = self._move_to_bay(arrival.slot, record.bay, arrival.camera)
        if slot is None:
            record.refused[key] = f"its run has no free slot for row {row}"
            return self._refuse(arrival, record.refused[key], record)
        if error_s is not None:
            frame = _observed(arrival, row, record.pulses[row].host_s + error_s)
            record.complete_frames[arrival.camera].append(frame)
        record.last_frame_host_s = max(record.last_frame_host_s or 0.0, arrival.host_time_s)
        reported_us, reported_gains = record.taken_with(row)
        exposures_us, gains = reported_us or self._exposures_us, reported_gains or self._gains
        record.frames[key] = FrameRecord(
            camera=arrival.camera,
            row=row,
            verdict=verdict,
            cause="" if verdict is Verdict.OK else arrival.fault or "parts of the frame were lost in transfer",
            slot=slot,
            frame_id=arrival.frame_id,
            camera_time_s=arrival.time_s,
            pulse_error_us=None if error_s is None else error_s * 1e6,
            exposure_us=exposures_us[arrival.camera] if exposures_us else None,
            gain=gains[arrival.camera] if gains else None,
            light=record.pulses[row].event.light if row in record.pulses else "",
        )
        return Settled(record.run, record.frames[key])

    def _refuse(self, arrival: Arrival, reason: str, record: RunRecord | None = None) -> Unassigned:
        """Return the outcome of a refused frame. Count the frame in `record`, or else in the newest open run."""
        counted = record or next(iter(self.open_runs[-1:]), None)
        if counted is not None:
            counted.unassigned += 1
        return Unassigned(arrival.camera, arrival.slot, reason)

    def _try_finish(self, record: RunRecord, now_s: float) -> list[Outcome]:
        if record.pulse_count is None:
            return []
        if record.run is None:
            record.finished = True
            return []
        overdue = now_s >= record.deadline_s
        # Pulses that are reported later may be further candidates for an incomplete frame of these cameras.
        undecided = {a.camera for a in self._undated if not self._is_decidable(a, now_s)}
        out: list[Outcome] = []
        for camera in range(len(self._camera_clocks)):
            forced = {a: row for a, (r, row) in self._assign_undated(camera, now_s).items() if r is record}
            settles_all = camera not in undecided and set(forced.values()) == set(record.open_rows(camera))
            # Before the deadline complete frames may still arrive for open rows, which would change the candidates.
            if forced and (overdue or settles_all):
                for arrival, row in forced.items():
                    self._undated.remove(arrival)
                    out.append(self._take(record, row, arrival, Verdict.INCOMPLETE))
        if overdue or len(record.frames) == record.rows * len(self._camera_clocks):
            out += self._finish(record, now_s, overdue)
        return out

    def _assign_undated(self, camera: int, now_s: float) -> dict[Arrival, tuple[RunRecord, int]]:
        decidable = [a for a in self._undated if a.camera == camera and self._is_decidable(a, now_s)]
        runs = dict(enumerate(self._runs))
        chosen = assign_forced([self._candidates(a) for a in decidable])
        return {decidable[n]: (runs[index], row) for n, (index, row) in chosen.items()}

    def _is_decidable(self, arrival: Arrival, now_s: float) -> bool:
        """Return whether all pulses to which a frame may belong have been reported."""
        return self._is_reported(arrival) or now_s >= arrival.host_time_s + REPORT_DELAY_S

    def _is_reported(self, arrival: Arrival) -> bool:
        return self._known_until_s >= arrival.host_time_s

    def _candidates(self, arrival: Arrival) -> set[tuple[int, int]]:
        found = set()
        for n, record in enumerate(self._runs):
            latest_s = record.period_s + LATE_S
            for row in record.open_rows(arrival.camera):
                fired = record.pulses.get(row)
                # If the report of a pulse was lost, its time is unknown: its row is a candidate for every such frame.
                if fired is None or -EARLY_S <= arrival.host_time_s - fired.host_s <= latest_s:
                    found.add((n, row))
        return found

    def _give_up_undated(self, now_s: float) -> list[Outcome]:
        out: list[Outcome] = []
        for arrival in list(self._undated):
            runs = [self._runs[n] for n, _ in self._candidates(arrival)]
            may_be_reported = not self._is_reported(arrival) and not self._is_aged(arrival, now_s)
            if self._is_decidable(arrival, now_s) and all(r.finished for r in runs) and not may_be_reported:
                self._undated.remove(arrival)
                reason = "several pulses are possible" if runs else "no pulse lacks a frame"
                out.append(self._refuse(arrival, f"incomplete, and {reason}"))
        return out

    def _awaits_reading(self, record: RunRecord) -> bool:
        cameras = (n for n in record.doubted if not self.outages.is_away(n))
        return any(self._camera_clocks[n].read_s < record.last_arrival_s(n) for n in cameras)

    def _finish(self, record: RunRecord, now_s: float, overdue: bool) -> list[Outcome]:
        assert record.run is not None
        if not overdue and self._awaits_reading(record):
            return []
        place = next(n for n, r in enumerate(self._runs) if r is record)
        previous = self._runs[place - 1] if place and self._runs[place - 1].run is not None else None
        bound_s = self._controller_clock.bound_s()
        unassigned = [[*kept] for kept in self._unassigned]
        for arrival, host_s in self._waiting:
            # A frame after the last pulse waits for a later event of the controller, which may come with another board.
            if host_s + self._latencies[arrival.camera].gate_s + REPORT_DELAY_S < now_s:
                unassigned[arrival.camera].append(_observed(arrival, None, host_s))
        missing, proof = judge_run(record, unassigned, self.outages, bound_s, previous)
        record.doubted = cameras_in_doubt(proof)
        if not overdue and self._awaits_reading(record):
            return []
        record.finished = True
        conclude_run(record, missing, proof)
        self._latencies.revise(proof)
        ordered = tuple(record.frames[key] for key in sorted(record.frames))
        return [*(Settled(record.run, frame) for frame in missing), Finished(record, ordered, proof)]


def _observed(arrival: Arrival, row: int | None, host_s: float) -> ObservedFrame:
    assert arrival.time_s is not None
    return ObservedFrame(row, arrival.frame_id, arrival.time_s, host_s, arrival.host_time_s, 0, arrival.stated)
