"""Watch of the calibration: a worker checks cameras and lights after every run, and drift or dimness becomes a warning.

The worker performs the check after it has sent the run's result, so the check does not delay this result.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from pydantic import ValidationError

from vaoi_station.drift.checks import CameraCheck, KeptBaselines, LampBaseline, RunCheck
from vaoi_station.drift.lamp_watch import BASELINE_RUNS, DimLamp, find_dim_lamps, only_baselines, with_baselines
from vaoi_station.drift.watch import VANISHED_RUNS, Drift, find_drifts, find_vanished_cameras
from vaoi_station.errors import StateError
from vaoi_station.model import Calibration, Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.schemas import CalibrationStatus, CameraCalibration, CameraDrift, CameraMoment
from vaoi_station.runs.workers.jobs import CheckJob, Reply
from vaoi_station.store.documents import CalibrationChecks, digest_of

FIRST_CHECKS, LATEST_CHECKS = 50, 200
"""Numbers of checks that are evaluated: the first ones since the calibration came into force, and the latest ones."""
MOST_TYPES = 200
"""Number of board types whose brightness is kept. The type that was not filmed for the longest time is forgotten."""
HISTORY_RUNS = 50
"""Largest number of runs in the history of each camera."""
_UNSEEN_RUNS = 5
"""Number of successive runs without evidence of a camera after which the camera's state is `unseen`."""
CODE = "calibration-drift"


class CalibrationWatch:
    """Collects the checks of the calibration in force and finds drifted cameras and dim lights.

    Used by the coordinator's thread only.
    """

    def __init__(
        self, checks: CalibrationChecks, events: EventLog, calibration: Calibration, names: Sequence[str]
    ) -> None:
        self._kept, self._events, self._names = checks, events, tuple(names)
        self.on_checked: Callable[[RunCheck], None] = lambda _check: None
        """Function that receives every check under the calibration in force. It must return at once."""
        self.digest = digest_of(calibration.model_dump_json())
        self._created = calibration.created
        known = [
            check
            for text in checks.documents(self.digest, FIRST_CHECKS, LATEST_CHECKS)
            if (check := _parsed(text, len(self._names))) is not None
        ]
        self._first, self._latest = known[:FIRST_CHECKS], deque(known[FIRST_CHECKS:], LATEST_CHECKS)
        # A board type may pause for more runs than are evaluated or stored; its baselines stay those of its first runs.
        self._last_of = {check.board_type: check for check in self._kept_baselines()}
        for check in known:
            self._remember(check)
        self._runs = checks.count(self.digest)
        self._drifts, self._vanished = find_drifts(known), find_vanished_cameras(known)
        self._dim = find_dim_lamps(known)

    def warnings(self) -> tuple[Reason, ...]:
        """Return one warning per drifted camera, per camera without evidence in the latest runs, and per dim light."""
        drifted = [Reason(code=CODE, message=self._message(d), action=self._action(d)) for d in self._drifts]
        dim = (self._dim_reason(lamp) for lamp in self._dim)
        return (*drifted, *(self._unseen(camera) for camera in self._vanished), *dim)

    def status(self) -> CalibrationStatus:
        """Return the calibration in force, with the displacement and the state of every camera."""
        return CalibrationStatus(
            digest=self.digest,
            created=self._created,
            runs=self._runs,
            cameras=tuple(self._camera(i) for i in range(len(self._names))),
        )

    def checked(self, job: CheckJob, reply: Reply) -> None:
        """Store a drift check, and publish an event for each drift that begins or ends with it."""
        run, digest = job.run, job.calibration
        if reply.error is not None:
            if not isinstance(reply.error, StateError):  # the station is stopping, which is no trouble
                self._events.add("trouble", reply.error.message, run=run, code="calibration-not-checked")
            return
        check: RunCheck = reply.value
        if digest == self.digest:
            check = with_baselines(check, [*self._last_of.values(), *self._first, *self._latest])
        self._kept.save(run, digest, check.model_dump_json())
        if digest != self.digest:
            return  # The run was stitched with another calibration, so its check is not about the present one.
        self.on_checked(check)
        if self._remember(check):
            kept = KeptBaselines(calibration=digest, types=tuple(self._last_of.values()))
            self._kept.save_baselines(kept.model_dump_json())
        self._runs += 1
        (self._first if len(self._first) < FIRST_CHECKS else self._latest).append(check)
        checks = [*self._first, *self._latest]
        before, gone = self._drifts, self._vanished
        self._drifts, self._vanished = find_drifts(checks), find_vanished_cameras(checks)
        for camera in sorted({*self._vanished} - {*gone}):
            reason = self._unseen(camera)
            name = {"camera": self._names[camera]}
            self._events.add("trouble", reason.message, run=run, code=reason.code, action=reason.action, subject=name)
        self._publish_changes(before, run)
        dim, self._dim = self._dim, find_dim_lamps(checks)
        self._publish_lamps(dim, run)

    def _remember(self, check: RunCheck) -> bool:
        """Keep the latest baselines of the check's board type; return whether they have changed."""
        before = self._last_of.pop(check.board_type, None)
        now = only_baselines(check, before)
        if now.lamps:
            self._last_of[check.board_type] = now
        if len(self._last_of) > MOST_TYPES:
            del self._last_of[next(iter(self._last_of))]
        return _baselines_of(now) != _baselines_of(before)

    def _kept_baselines(self) -> tuple[RunCheck, ...]:
        """Return the stored baselines under this calibration."""
        try:
            kept = KeptBaselines.model_validate_json(self._kept.baselines() or "")
        except ValidationError:  # none, or of another version
            return ()
        return kept.types if kept.calibration == self.digest else ()

    def _publish_changes(self, before: tuple[Drift, ...], run: str) -> None:
        """Publish an event for each new or ended drift. `before` lists the drifts before this check."""
        known, now = {d.camera for d in before}, {d.camera for d in self._drifts}
        for d in self._drifts:
            if d.camera not in known:
                name = {"camera": self._names[d.camera]}
                message, action = self._message(d), self._action(d)
                self._events.add("trouble", message, run=run, code=CODE, action=action, subject=name)
        for camera in sorted(known - now):
            message = f"Camera {self._names[camera]} is back at its calibrated position."
            self._events.add("calibration", message, run=run, subject={"camera": self._names[camera]})

    def _publish_lamps(self, before: tuple[DimLamp, ...], run: str) -> None:
        """Publish an event for each light that has become dim, or is no longer. `before`: as before this check."""
        known, now = {lamp.light for lamp in before}, {lamp.light for lamp in self._dim}
        for lamp in self._dim:
            if lamp.light not in known:
                reason = self._dim_reason(lamp)
                self._events.add("trouble", reason.message, run=run, code=reason.code, action=reason.action)
        for light in sorted(known - now):
            message = f"{_light(light)} is as bright as before again."
            self._events.add("calibration", message, run=run)

    def _dim_reason(self, lamp: DimLamp) -> Reason:
        cameras = ", ".join(self._names[i] for i in lamp.cameras)
        kind = "camera" if len(lamp.cameras) == 1 else "cameras"
        shown = "1 board shows it" if lamp.runs == 1 else f"{lamp.runs} boards show it"
        also = " All cameras and lights show it, so the boards may be darker instead." if lamp.everywhere else ""
        return Reason(
            code="lamp-dim",
            message=f"{_light(lamp.light)} is dim in {kind} {cameras}: boards have {lamp.share:.0%} of the brightness "
            f"of the first {BASELINE_RUNS} of their type, since run {lamp.since_run} ({lamp.since_time}); "
            f"{shown}.{also}",
            action=f"Call the engineer: check LEDs, cable and driver of the light, and the lens of {kind} {cameras}; "
            "after the repair film new flat fields (`vaoi flatfield`).",
        )

    def _unseen(self, camera: int) -> Reason:
        name = self._names[camera]
        return Reason(
            code="calibration-unseen",
            message=f"The last {VANISHED_RUNS} boards show nothing of camera {name}'s position: it no longer sees what "
            "its neighbours see.",
            action=f"Call the engineer: check whether camera {name} was knocked, is covered or out of focus.",
        )

    def _message(self, d: Drift) -> str:
        seen = "1 board shows it" if d.runs == 1 else f"{d.runs} boards show it"
        # Links between two neighbouring cameras show only their relative displacement, not which of the two has moved.
        instead = "".join(f" (or {self._names[i]} the other way)" for i in d.instead)
        return (
            f"Camera {self._names[d.camera]}{instead} is displaced by {d.size_px:.2f} px from its calibration since "
            f"run {d.since_run} ({d.since_time}); {seen}."
        )

    def _action(self, d: Drift) -> str:
        return (
            f"Call the engineer: check whether camera {self._names[d.camera]} is loose or was knocked; then calibrate, "
            "or adopt what `vaoi recalibrate` proposes."
        )

    def _camera(self, i: int) -> CameraCalibration:
        shown = [*self._first, *self._latest][-HISTORY_RUNS:]
        drift = next((d for d in self._drifts if d.camera == i), None)
        recent = shown[-_UNSEEN_RUNS:]
        state = "unknown" if not recent else "steady" if any(c.cameras[i].seen for c in recent) else "unseen"
        return CameraCalibration(
            camera=i,
            name=self._names[i],
            state="drifted" if drift is not None else state,
            drift=None if drift is None else _drift_of(drift),
            history=tuple(_moment(check, check.cameras[i]) for check in shown),
        )


def _baselines_of(check: RunCheck | None) -> list[tuple[int, str, LampBaseline | None]]:
    return [] if check is None else sorted(((p.camera, p.light, p.baseline) for p in check.lamps), key=str)


def _light(name: str) -> str:
    return f"Light {name}" if name else "The light"


def _drift_of(d: Drift) -> CameraDrift:
    x, y, turn = (round(v, 4) for v in d.displacement_px)
    return CameraDrift(
        size_px=round(d.size_px, 4),
        x_px=x,
        y_px=y,
        turn_px=turn,
        since_run=d.since_run,
        since=d.since_time,
        runs=d.runs,
        instead=d.instead,
    )


def _moment(check: RunCheck, camera: CameraCheck) -> CameraMoment:
    return CameraMoment(
        run=check.run,
        time=check.time,
        x_px=camera.x_px,
        y_px=camera.y_px,
        turn_px=camera.turn_px,
        sigma_px=max(camera.sigma_px),
        rms_px=camera.rms_px,
        links=camera.links,
        fiducials=camera.fiducials,
    )


def _parsed(text: str, cameras: int) -> RunCheck | None:
    """Return a stored check; None if it is damaged or of another version. No row may prevent the station's start."""
    try:
        check = RunCheck.model_validate_json(text)
    except ValidationError:
        return None
    named = (*check.rivals, *(lamp.camera for lamp in check.lamps))
    fits = len(check.cameras) == cameras and all(0 <= camera < cameras for camera in named)
    return check if fits else None
