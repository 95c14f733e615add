"""Pairs every pulse with one frame per camera, by time, and ends every run with a verdict for all.

Pure logic: events, arrivals and the time of day come in, outcomes go out; there is no thread and no
device here. A frame belongs to the pulse nearest to its time stamp, both mapped to the host's clock, if
it is near enough; never to a pulse because of the order of arrival. A pulse and its frames may become
known in either order, and frames of one run may come while the next is filmed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from vaoi_station.acquisition.cameras.interface import Arrival
from vaoi_station.acquisition.causes import Outages
from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.elimination import eliminate
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.records import KnownPulse, Seen
from vaoi_station.acquisition.pairing.run_conclusion import conclude
from vaoi_station.acquisition.pairing.run_sheet import RunSheet
from vaoi_station.model import FrameRecord, Pulse, Verdict

EXTRA = 256
"""Frames of no pulse that are remembered, for the proof of the runs about their time."""
REMEMBERED = 4
"""Sheets kept, so that a late frame of an earlier run is recognised as one."""


@dataclass(frozen=True)
class Limits:
    """How near, how late."""

    tolerance_s: float = 0.010
    """Between time stamp and pulse, beside both clocks' bounds; never more than half a period."""
    late_s: float = 0.5
    """Frames are waited for so much longer than one period after the last pulse."""
    lag_s: float = 0.1
    """The controller's report of a pulse comes no later than this after the pulse."""
    unexplained_s: float = 5.0
    """A frame without any pulse is given up after this time: longer than a controller runs on without its host (3 s),
    whose reports are read when the line is back."""


@dataclass(frozen=True)
class Settled:
    """One (camera, row) has its verdict."""

    run: str
    frame: FrameRecord


@dataclass(frozen=True)
class Stray:
    """A frame that belongs to no (camera, row) of a run; its slot is free again."""

    camera: int
    slot: int
    why: str


@dataclass(frozen=True)
class Finished:
    """Every (camera, row) of a run has its verdict, ordered by camera, then row."""

    sheet: RunSheet
    frames: tuple[FrameRecord, ...]
    proof: TriggerProof


Outcome = Settled | Stray | Finished


class Recorder:
    """All runs that are open or fresh in memory."""

    def __init__(
        self,
        controller_clock: ClockModel,
        camera_clocks: Sequence[ClockModel],
        limits: Limits | None = None,
        home: Callable[[int, int, int], int | None] = lambda slot, _bay, _camera: slot,
        exposures_us: Sequence[float] = (),
    ) -> None:
        """Start with no run.

        Args:
            controller_clock: maps pulse times to the host's clock.
            camera_clocks: map time stamps of every camera.
            limits: what is believed, and how long is waited.
            home: `home(slot, bay, camera)` brings a frame into its run's bay: the slot where it is then, or None.
            exposures_us: of every camera, where the controller does not tell them pulse by pulse.
        """
        self.limits = limits or Limits()
        self.outages = Outages()
        """When cameras were away, by what they told."""
        self._controller_clock = controller_clock
        self._camera_clocks = camera_clocks
        self._home = home
        self._exposures_us = exposures_us
        self._sheets: list[RunSheet] = []
        self._waiting: list[tuple[Arrival, float]] = []
        """Complete frames whose pulse is not known yet, with the host time of their exposure."""
        self._extra: list[deque[Seen]] = [deque(maxlen=EXTRA) for _ in camera_clocks]
        """Of every camera, the newest whole frames that belong to no pulse."""
        self._unnamed: list[Arrival] = []
        """Frames without a trustworthy time."""
        self._known_until_s = float("-inf")
        """The controller has told everything up to this host time."""

    @property
    def open_runs(self) -> list[RunSheet]:
        """Runs not finished yet."""
        return [s for s in self._sheets if not s.finished]

    def begin(self, run: str | None, bay: int | None, period_s: float) -> RunSheet:
        """A board is about to be filmed (`run` None: nobody has memory for it)."""
        sheet = RunSheet(run, bay, period_s)
        self._sheets.append(sheet)
        return sheet

    def heard(self, time_s: float) -> None:
        """The controller reported something at its time `time_s`; all earlier pulses are known by now."""
        self._known_until_s = max(self._known_until_s, self._controller_clock.host_s(time_s))

    def pulse(self, event: PulseFired, now_s: float) -> tuple[Pulse, Iterator[Outcome]]:
        """A pulse of the newest run; frames that were there before it find their place now."""
        self.heard(event.time_s)
        pulse = Pulse(index=event.index, time_s=event.time_s, light=event.light)
        host_s = self._controller_clock.host_s(event.time_s)
        self._sheets[-1].pulses[event.index] = KnownPulse(pulse, host_s, event.exposures_us, now_s)
        return pulse, self.settle(now_s)

    def end(self, sheet: RunSheet, pulses: int, reason: str, now_s: float) -> Iterator[Outcome]:
        """The last pulse of a run has been fired."""
        if sheet.pulse_count is None:
            sheet.pulse_count, sheet.reason = pulses, reason
            sheet.deadline_s = now_s + sheet.period_s + self.limits.late_s
        return self.settle(now_s)

    def arrive(self, arrival: Arrival, now_s: float) -> Iterator[Outcome]:
        """A camera has finished with a slot."""
        if arrival.complete and arrival.time_s is not None:
            self._waiting.append((arrival, self._camera_clocks[arrival.camera].host_s(arrival.time_s)))
        else:
            self._unnamed.append(arrival)
        return self.settle(now_s)

    def settle(self, now_s: float) -> Iterator[Outcome]:
        """Everything that can be decided by now; call it again at `next_deadline_s` at the latest.

        To be read to its end: a frame's place is told before the proof of its run is worked out.
        """
        yield from self._placed(now_s)
        for sheet in self.open_runs:
            yield from self._try_finish(sheet, now_s)
        yield from self._give_up_unnamed(now_s)
        finished = [s for s in self._sheets if s.finished]
        for sheet in finished[:-REMEMBERED]:
            self._sheets.remove(sheet)

    def _placed(self, now_s: float) -> list[Outcome]:
        """Of frames that wait, those whose place is known now."""
        out: list[Outcome] = []
        waiting, self._waiting = self._waiting, []
        for arrival, host_s in waiting:
            placed = self._place(arrival, host_s, now_s)
            if placed is None:
                self._waiting.append((arrival, host_s))
            else:
                out.append(placed)
        return out

    def next_deadline_s(self, after_s: float) -> float | None:
        """The first host time after `after_s` at which `settle` may decide something without further news."""
        limits = self.limits
        times = [a.host_time_s + limits.unexplained_s for a, _ in self._waiting]
        times += [a.host_time_s + age_s for a in self._unnamed for age_s in (limits.lag_s, limits.unexplained_s)]
        times += [s.deadline_s for s in self.open_runs]
        return min((t for t in times if t > after_s), default=None)

    def _told(self, arrival: Arrival) -> bool:
        return self._known_until_s >= arrival.host_time_s

    def _place(self, arrival: Arrival, host_s: float, now_s: float) -> Outcome | None:
        """The pulse nearest in time, if it is near enough; None while a nearer one may still be reported."""
        near = [(abs(found[1]), n, *found) for n, s in enumerate(self._sheets) if (found := s.nearest(host_s))]
        if near:
            distance_s, n, row, error_s = min(near)
            if distance_s <= self._gate_s(self._sheets[n], arrival.camera):
                return self._take(self._sheets[n], row, arrival, Verdict.OK, error_s)
        if host_s + self.limits.tolerance_s < self._known_until_s or self._aged(arrival, now_s):
            self._note_extra(arrival, host_s)
            off = f"; the nearest is {min(near)[0] * 1e3:.1f} ms away" if near else ""
            return self._stray(arrival, f"no pulse was fired when it was exposed{off}")
        return None

    def _gate_s(self, sheet: RunSheet, camera: int) -> float:
        bounds_s = self._controller_clock.bound_s() + self._camera_clocks[camera].bound_s()
        return min(sheet.shortest_interval_s / 2, self.limits.tolerance_s + bounds_s)

    def _aged(self, arrival: Arrival, now_s: float) -> bool:
        return now_s >= arrival.host_time_s + self.limits.unexplained_s

    def _take(
        self, sheet: RunSheet, row: int, arrival: Arrival, verdict: Verdict, error_s: float | None = None
    ) -> Outcome:
        """Give a frame to its (camera, row), unless that has one, or its run is over or nobody's."""
        key = (arrival.camera, row)
        if key in sheet.taken:
            if error_s is not None:
                self._note_extra(arrival, sheet.pulses[row].host_s + error_s)
            return self._stray(arrival, f"camera {key[0]} has a frame of row {row} already", sheet)
        sheet.taken.add(key)
        if sheet.run is None or sheet.bay is None:
            return Stray(arrival.camera, arrival.slot, "its board was missed: no memory had been granted")
        if sheet.finished:
            return self._stray(arrival, f"it belongs to row {row} of run {sheet.run}, which is over")
        slot = self._home(arrival.slot, sheet.bay, arrival.camera)
        if slot is None:
            sheet.refused[key] = f"there is no memory left in its run for row {row}"
            return self._stray(arrival, sheet.refused[key], sheet)
        if error_s is not None:
            sheet.seen[arrival.camera].append(_seen(arrival, row, sheet.pulses[row].host_s + error_s))
        sheet.last_frame_host_s = max(sheet.last_frame_host_s or 0.0, arrival.host_time_s)
        sheet.frames[key] = FrameRecord(
            camera=arrival.camera,
            row=row,
            verdict=verdict,
            cause="" if verdict is Verdict.OK else arrival.fault or "parts of the frame were lost on the way",
            slot=slot,
            frame_id=arrival.frame_id,
            camera_time_s=arrival.time_s,
            pulse_error_us=None if error_s is None else error_s * 1e6,
            exposure_us=self._exposure_us(sheet, arrival.camera, row),
            light=sheet.pulses[row].pulse.light if row in sheet.pulses else "",
        )
        return Settled(sheet.run, sheet.frames[key])

    def _note_extra(self, arrival: Arrival, host_s: float) -> None:
        self._extra[arrival.camera].append(_seen(arrival, None, host_s))

    def _exposure_us(self, sheet: RunSheet, camera: int, row: int) -> float | None:
        told = sheet.pulses[row].exposures_us if row in sheet.pulses else ()
        known = told or self._exposures_us
        return known[camera] if known else None

    def _stray(self, arrival: Arrival, why: str, sheet: RunSheet | None = None) -> Stray:
        counted = sheet or next(iter(self.open_runs[-1:]), None)
        if counted is not None:
            counted.strays += 1
        return Stray(arrival.camera, arrival.slot, why)

    def _try_finish(self, sheet: RunSheet, now_s: float) -> list[Outcome]:
        if sheet.pulse_count is None:
            return []
        if sheet.run is None:
            sheet.finished = True
            return []
        overdue = now_s >= sheet.deadline_s
        unripe = {a.camera for a in self._unnamed if not self._ripe(a, now_s)}
        out: list[Outcome] = []
        for camera in range(len(self._camera_clocks)):
            named = {a: row for a, (s, row) in self._name(camera, now_s).items() if s is sheet}
            settles_all = camera not in unripe and set(named.values()) == set(sheet.open_rows(camera))
            if named and (overdue or settles_all):
                for arrival, row in named.items():
                    self._unnamed.remove(arrival)
                    out.append(self._take(sheet, row, arrival, Verdict.INCOMPLETE))
        if overdue or len(sheet.frames) == sheet.rows * len(self._camera_clocks):
            out += self._finish(sheet)
        return out

    def _name(self, camera: int, now_s: float) -> dict[Arrival, tuple[RunSheet, int]]:
        """By elimination, to which (run, row) the unnamed frames of a camera must belong."""
        ripe = [a for a in self._unnamed if a.camera == camera and self._ripe(a, now_s)]
        sheets = dict(enumerate(self._sheets))
        chosen = eliminate([self._candidates(a) for a in ripe])
        return {ripe[n]: (sheets[index], row) for n, (index, row) in chosen.items()}

    def _ripe(self, arrival: Arrival, now_s: float) -> bool:
        """Whether all pulses it may belong to are known."""
        return self._told(arrival) or now_s >= arrival.host_time_s + self.limits.lag_s

    def _candidates(self, arrival: Arrival) -> set[tuple[int, int]]:
        """(index of sheet, row) that have no frame, were fired before it arrived, and not too long before."""
        found = set()
        for n, sheet in enumerate(self._sheets):
            latest_s = sheet.period_s + self.limits.late_s
            for row in sheet.open_rows(arrival.camera):
                fired = sheet.pulses.get(row)
                if fired is None or -self.limits.tolerance_s <= arrival.host_time_s - fired.host_s <= latest_s:
                    found.add((n, row))
        return found

    def _give_up_unnamed(self, now_s: float) -> list[Outcome]:
        """Unnamed frames that no open run can claim any more."""
        out: list[Outcome] = []
        for arrival in list(self._unnamed):
            sheets = [self._sheets[n] for n, _ in self._candidates(arrival)]
            if self._ripe(arrival, now_s) and all(s.finished for s in sheets) and not self._expects(arrival, now_s):
                self._unnamed.remove(arrival)
                why = "it may be of several pulses" if sheets else "no pulse waits for it"
                out.append(self._stray(arrival, f"incomplete, and {why}"))
        return out

    def _expects(self, arrival: Arrival, now_s: float) -> bool:
        """Without any pulse to think of, wait a while for the controller to tell of one."""
        return not self._told(arrival) and not self._aged(arrival, now_s)

    def _finish(self, sheet: RunSheet) -> list[Outcome]:
        """Verdicts for what never came, and the proof of what did."""
        assert sheet.run is not None
        sheet.finished = True
        place = next(n for n, s in enumerate(self._sheets) if s is sheet)
        before = self._sheets[place - 1] if place and self._sheets[place - 1].run is not None else None
        missing, proof = conclude(sheet, self._extra, self.outages, self._controller_clock.bound_s(), before)
        ordered = tuple(sheet.frames[key] for key in sorted(sheet.frames))
        return [*(Settled(sheet.run, record) for record in missing), Finished(sheet, ordered, proof)]


def _seen(arrival: Arrival, row: int | None, host_s: float) -> Seen:
    assert arrival.time_s is not None
    return Seen(row, arrival.frame_id, arrival.time_s, host_s, arrival.host_time_s)
