"""Learn the latencies of all cameras during runs: which frames must wait, and which latency each run shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from vaoi_station.acquisition.pairing.latency import SILENT_PERIODS, Beginning, CameraLatency, LatencySettings
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.run_record import RunRecord


class WaitingFrame(NamedTuple):
    """A complete frame that is not assigned yet."""

    host_s: float
    """Time stamp of the frame by the host's clock."""
    aged: bool
    """Whether the frame has waited so long that it must be assigned or refused now."""


class Latencies:
    """The latencies (pulse to time stamp) of all cameras of a station, learnt from one run to the next."""

    def __init__(self, settings: Sequence[LatencySettings], bound_s: Callable[[int, float], float]) -> None:
        """Begin with the configured latencies.

        Args:
            settings: configuration of every camera's latency.
            bound_s: returns the error bound of the difference between a camera's time stamp and a pulse, given the
                camera and the host time.
        """
        self._cameras = [CameraLatency(s) for s in settings]
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
        waiting: Sequence[WaitingFrame],
        unassigned_s: Sequence[float],
        now_s: float,
    ) -> None:
        """Learn the latency of a camera from its waiting frames, unless it is known.

        Args:
            camera: the camera.
            runs: all runs that are open or recently finished, oldest first.
            waiting: all frames of this camera that are not assigned yet.
            unassigned_s: time stamps of frames of this camera that belong to no pulse, by the host's clock.
            now_s: host time.
        """
        latency = self._cameras[camera]
        for run in runs:
            own = [f for f in waiting if self._owner(runs, camera, f.host_s) is run]
            if latency.confirmed or run.finished or not own or camera in run.latency_known:
                continue
            bound_s = max(self._bound_s(camera, f.host_s) for f in own)
            exposed_s = [*(f.host_s for f in waiting), *unassigned_s]
            # Frames were taken before an earlier run, which finished meanwhile, showed that the latency is not sure.
            taken = run.complete_frames[camera]
            found = latency.learn(
                Beginning(
                    pulses_s=sorted(p.host_s for p in run.pulses.values()),
                    frames_s=sorted([*(f.host_s for f in own), *(f.host_s for f in taken)]),
                    period_s=run.least_period_s,
                    bound_s=bound_s,
                    from_silence=run.has_first_pulse and _was_silent(run, runs, exposed_s, bound_s),
                    all_fired=run.all_fired,
                    overdue=now_s >= run.deadline_s or any(f.aged for f in own),
                )
            )
            if found is not None:
                # A frame that was taken by another latency may be in a wrong row.
                fits = all(abs(run.latency_s(f) - found.latency_s) <= latency.gate_s for f in taken)
                run.latency_known[camera] = found.confirmed and fits

    def revise(self, proof: TriggerProof) -> None:
        """Update the latencies of all cameras from the proof of a finished run."""
        for camera in proof.cameras:
            # Frames in doubt show nothing about the latency, except the latency at which they would follow their pulses
            # one by one.
            measured_us = camera.latency_us if camera.proven else None
            self._cameras[camera.camera].revise(
                None if measured_us is None else measured_us * 1e-6,
                None if camera.in_order_us is None else camera.in_order_us * 1e-6,
                camera.frames,
                camera.extra,
            )

    def _owner(self, runs: Sequence[RunRecord], camera: int, host_s: float) -> RunRecord | None:
        """Return the newest run whose pulses had begun at a time stamp; None if there is none."""
        latest_s = host_s + self._bound_s(camera, host_s)
        return next((r for r in reversed(runs) if r.pulses and r.first_s <= latest_s), None)


def _was_silent(run: RunRecord, runs: Sequence[RunRecord], exposed_s: Sequence[float], bound_s: float) -> bool:
    """Whether a camera exposed nothing, and no pulse was fired, for some periods before the first pulse of a run."""
    until_s = run.first_s - bound_s
    since_s = until_s - SILENT_PERIODS * run.measured_period_s
    pulses_s = [p.host_s for r in runs if r is not run for p in r.pulses.values()]
    return not any(since_s < s < until_s for s in (*exposed_s, *pulses_s))
