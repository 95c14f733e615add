"""The latency of each camera: the time from a pulse to the time stamp of its frame. Pure logic.

It may be more than a trigger period T, and φ, φ + T and φ + 2 T fit the frames of a run equally well; a wrong one would
move all frames by rows. Only the beginning of a run decides: no pulse was fired before it, and no frame has a time
stamp before its pulse. Until a frame of the first pulse confirms the latency, the frames of the camera wait.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from vaoi_station.acquisition.pairing.evidence import ENOUGH, GATE_S, median
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.run_record import RunRecord
from vaoi_station.config import CameraConfig

SILENT_PERIODS = 2
"""If no frame comes for this number of periods before the first pulse, the first frame belongs to the first pulse."""


@dataclass(frozen=True)
class LatencySettings:
    """The configuration of one camera's latency."""

    given_s: float | None = None
    gate_s: float = GATE_S

    @classmethod
    def of(cls, camera: CameraConfig) -> LatencySettings:
        """Return the settings of a camera of station.toml."""
        # The time stamps of a replayed recording are the times of its pulses.
        given_us = 0.0 if camera.latency_us is None and camera.backend == "replay" else camera.latency_us
        return cls(None if given_us is None else given_us * 1e-6, camera.latency_gate_us * 1e-6)


@dataclass(frozen=True)
class Beginning:
    """The pulses and frames of one camera from the beginning of a run, all by the host's clock, in ascending order."""

    pulses_s: Sequence[float]
    frames_s: Sequence[float]
    period_s: float
    """The shortest time between two pulses of the run: a belt that spaces the rows brings them at other intervals than
    the trigger period."""
    bound_s: float
    """Error bound of the controller's clock plus that of the camera's clock."""
    from_silence: bool
    """Whether `pulses_s` begins with the run's first pulse, and the camera delivered no frame shortly before it."""
    all_fired: bool = False
    overdue: bool = False


Learnt = tuple[float, bool]
"""A latency, s, and whether the beginning of a run confirms it. If not, it may be wrong by whole periods."""


@dataclass
class CameraLatency:
    """The latency of one camera, as far as it is known."""

    gate_s: float
    given: bool
    value_s: float
    confirmed: bool


def learn(begun: Beginning, expected_s: float, gate_s: float) -> Learnt | None:
    """Return the latency that the beginning of a run shows; None if more frames or pulses are needed."""
    pulses_s, frames_s, bound_s = begun.pulses_s, begun.frames_s, begun.bound_s
    spread_s = min(gate_s, begun.period_s / 2)
    if begun.from_silence and frames_s:
        first_s = frames_s[0] - pulses_s[0]
        if first_s >= -bound_s and abs(first_s - expected_s) <= spread_s:
            return (max(first_s, 0.0), True)
        begin_s = [f - p for f, p in zip(frames_s[:ENOUGH], pulses_s, strict=False)]
        # If the first frame is later than a period, it may be that of the second pulse, because that of the first was
        # lost.
        if (
            len(begin_s) == ENOUGH
            and _is_latency(begin_s, bound_s, spread_s)
            and max(begin_s) < begun.period_s - bound_s
        ):
            return (median(begin_s), True)
        # The only frame of a short run may not belong to the pulse, while the frame of the pulse is still under way.
        enough = begun.all_fired and len(frames_s) >= ENOUGH
        if enough and (all_s := in_order_s(pulses_s, frames_s, bound_s, spread_s)) is not None:
            return (all_s, True)
    shortest_s = [_since_pulse_s(pulses_s, f + bound_s) - bound_s for f in frames_s]
    if not (begun.overdue or _several_per_pulse(begun)):
        return None
    if not shortest_s or not _is_latency(shortest_s, bound_s, spread_s) or _several_per_pulse(begun):
        return (expected_s, False)
    found_s = max(median(shortest_s), 0.0)
    periods = round((expected_s - found_s) / begun.period_s)
    # The expected latency may be longer than a period. The frames then fit it as well.
    fits = periods > 0 and abs(expected_s - found_s - periods * begun.period_s) <= bound_s
    return (expected_s if fits else found_s, False)


def in_order_s(pulses_s: Sequence[float], frames_s: Sequence[float], bound_s: float, spread_s: float) -> float | None:
    """Return the latency at which the k-th frame belongs to the k-th pulse; None if there is no such latency."""
    if not frames_s or len(pulses_s) != len(frames_s):
        return None
    latencies_s = [f - p for f, p in zip(frames_s, pulses_s, strict=True)]
    return max(median(latencies_s), 0.0) if _is_latency(latencies_s, bound_s, spread_s) else None


def _is_latency(latencies_s: Sequence[float], bound_s: float, spread_s: float) -> bool:
    return min(latencies_s) >= -bound_s and max(latencies_s) - min(latencies_s) <= spread_s


def _since_pulse_s(pulses_s: Sequence[float], at_s: float) -> float:
    return at_s - pulses_s[max(bisect_right(pulses_s, at_s) - 1, 0)]


def _several_per_pulse(begun: Beginning) -> bool:
    pulses_s, bound_s = begun.pulses_s, begun.bound_s
    latest = [bisect_right(pulses_s, f + bound_s) for f in begun.frames_s]
    for (n, before_s), (following, after_s) in pairwise(zip(latest, begun.frames_s, strict=True)):
        if n == following < len(pulses_s):
            # Frames of consecutive pulses may seem to lie between the same two pulses, by the errors of the clocks and
            # of their time stamps. They are then no closer than these pulses, apart from these errors.
            interval_s = pulses_s[n] - pulses_s[n - 1] if n else begun.period_s
            if after_s - before_s < interval_s - 2 * bound_s:
                return True
    return False


class Latencies:
    """The latencies (pulse to time stamp) of all cameras of a station, learnt from one run to the next."""

    def __init__(self, settings: Sequence[LatencySettings], bound_s: Callable[[int, float], float]) -> None:
        self._cameras = [
            CameraLatency(s.gate_s, s.given_s is not None, s.given_s or 0.0, s.given_s is not None) for s in settings
        ]
        self._bound_s = bound_s

    def __getitem__(self, camera: int) -> CameraLatency:
        return self._cameras[camera]

    def awaits(self, runs: Sequence[RunRecord], camera: int, host_s: float) -> bool:
        """Return whether a frame with this time stamp waits until its run has shown the latency of its camera."""
        if self._cameras[camera].confirmed:
            return False
        run = self._owner(runs, camera, host_s)
        return run is not None and not run.finished and camera not in run.latency_known

    def learn(
        self,
        camera: int,
        runs: Sequence[RunRecord],
        waiting: Sequence[tuple[float, bool]],
        unassigned_s: Sequence[float],
        now_s: float,
    ) -> None:
        """Learn the latency of a camera from its waiting complete frames, unless it is known.

        Each is (time stamp by the host's clock, whether it has waited so long that it must be decided now).
        """
        latency = self._cameras[camera]
        for run in runs:
            own = [(s, aged) for s, aged in waiting if self._owner(runs, camera, s) is run]
            if latency.confirmed or run.finished or not own or camera in run.latency_known:
                continue
            bound_s = max(self._bound_s(camera, s) for s, _ in own)
            exposed_s = [*(s for s, _ in waiting), *unassigned_s]
            # Frames were taken before an earlier run, which finished meanwhile, showed that the latency is not sure.
            taken = run.complete_frames[camera]
            begun = Beginning(
                pulses_s=sorted(p.host_s for p in run.pulses.values()),
                frames_s=sorted([*(s for s, _ in own), *(f.host_s for f in taken)]),
                period_s=run.least_period_s,
                bound_s=bound_s,
                from_silence=run.has_first_pulse and _was_silent(run, runs, exposed_s, bound_s),
                all_fired=run.all_fired,
                overdue=now_s >= run.deadline_s or any(aged for _, aged in own),
            )
            found = learn(begun, latency.value_s, latency.gate_s)
            if found is not None:
                latency.value_s, latency.confirmed = found
                # A frame that was taken by another latency may be in a wrong row.
                fits = all(abs(run.latency_s(f) - latency.value_s) <= latency.gate_s for f in taken)
                run.latency_known[camera] = latency.confirmed and fits

    def revise(self, proof: TriggerProof) -> None:
        """Update the latencies of all cameras from the proof of a finished run."""
        for camera in proof.cameras:
            latency = self._cameras[camera.camera]
            if latency.given:
                continue
            if camera.in_order_us is not None:
                # The beginning of the next run shows whether a setting was changed or a fault occurred.
                latency.value_s, latency.confirmed = camera.in_order_us * 1e-6, False
            elif camera.extra > camera.frames:
                latency.confirmed = False
            elif camera.latency_us is not None and camera.proven and camera.frames > 1:
                latency.value_s = max(camera.latency_us * 1e-6, 0.0)

    def _owner(self, runs: Sequence[RunRecord], camera: int, host_s: float) -> RunRecord | None:
        latest_s = host_s + self._bound_s(camera, host_s)
        return next((r for r in reversed(runs) if r.pulses and r.first_s <= latest_s), None)


def _was_silent(run: RunRecord, runs: Sequence[RunRecord], exposed_s: Sequence[float], bound_s: float) -> bool:
    """Whether a camera exposed nothing, and no pulse was fired, for some periods before the first pulse of a run."""
    until_s = run.first_s - bound_s
    since_s = until_s - SILENT_PERIODS * run.measured_period_s
    pulses_s = [p.host_s for r in runs if r is not run for p in r.pulses.values()]
    return not any(since_s < s < until_s for s in (*exposed_s, *pulses_s))
