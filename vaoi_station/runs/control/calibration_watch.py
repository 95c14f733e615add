"""Watch of the calibration: a worker checks cameras and lights after every run, and drift or dimness becomes a warning.

The worker performs the check after it has sent the run's result, so the check does not delay this result.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from pydantic import ValidationError

from vaoi_station.drift.checks import KeptBaselines, LampBaseline, RunCheck
from vaoi_station.drift.lamp_watch import BASELINE_RUNS, DimLamp, find_dim_lamps, only_baselines, with_baselines
from vaoi_station.drift.recalibrate import MOST_RUNS, Proposal, calibrate_exchanged
from vaoi_station.drift.watch import VANISHED_RUNS, Drift, find_drifts, find_vanished_cameras
from vaoi_station.errors import InputError, StateError
from vaoi_station.model import Calibration, CameraHead, Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.schemas import (
    CalibrationStatus,
    CameraCalibration,
    CameraDrift,
    CameraExchange,
    CameraMoment,
)
from vaoi_station.runs.workers.jobs import Reply, WantedCheck
from vaoi_station.store.documents import CalibrationChecks, digest_of

FIRST_CHECKS, LATEST_CHECKS = 50, 200
"""Numbers of checks that are evaluated: the first ones since the calibration came into force, and the latest ones."""
MOST_TYPES = 200
"""Number of board types whose brightness is kept. The type that was not filmed for the longest time is forgotten."""
HISTORY_RUNS = 50
"""Largest number of runs in the history of each camera."""
_UNSEEN_RUNS = 5
"""Number of successive runs without evidence of a camera after which the camera's state is `unseen`."""


class CalibrationWatch:
    """Collects the checks of the calibration in force and finds drifted cameras and dim lights.

    Used by the coordinator's thread only.
    """

    def __init__(
        self,
        checks: CalibrationChecks,
        events: EventLog,
        calibration: Calibration,
        names: Sequence[str],
        heads: Sequence[CameraHead] = (),
    ) -> None:
        self._kept, self._events, self._names, self._heads = checks, events, tuple(names), heads
        self.on_checked: Callable[[RunCheck], None] = lambda _check: None
        """Function that receives every check under the calibration in force. It must return at once."""
        self.adopt(calibration)

    def adopt(self, calibration: Calibration) -> None:
        """Watch another calibration, which is in force from now on, by the checks that are stored of it."""
        self._calibration = calibration
        self.digest, self._created = digest_of(calibration.model_dump_json()), calibration.created
        documents = self._kept.documents(self.digest, FIRST_CHECKS, LATEST_CHECKS)
        known = [check for text in documents if (check := _parsed(text, len(self._names))) is not None]
        self._first, self._latest = known[:FIRST_CHECKS], deque(known[FIRST_CHECKS:], LATEST_CHECKS)
        # A board type may pause for more runs than are evaluated or stored; its baselines stay those of its first runs.
        self._last_of = {check.board_type: check for check in self._kept_baselines()}
        for check in known:
            self._remember(check)
        self._runs = self._kept.count(self.digest)
        self._evaluate()

    def proposal(self) -> Proposal:
        """Return the calibration with its exchanged cameras, by the boards since; `InputError`: they do not suffice."""
        checks = [*self._first, *self._latest][-MOST_RUNS:]
        return calibrate_exchanged(self._calibration, self._heads, checks)

    def warnings(self) -> tuple[Reason, ...]:
        """Return one warning per drifted camera, per camera without evidence in the latest runs, and per dim light."""
        return tuple(self._warnings.values())

    def status(self) -> CalibrationStatus:
        """Return the calibration in force, with the displacement and the state of every camera."""
        cameras = tuple(self._camera(i) for i in range(len(self._names)))
        return CalibrationStatus(digest=self.digest, created=self._created, runs=self._runs, cameras=cameras)

    def checked(self, job: WantedCheck, reply: Reply) -> None:
        """Store a drift check, and publish an event for each warning that begins or ends with it."""
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
        before = self._warnings
        self._evaluate()
        for key in [key for key in self._warnings if key not in before]:
            warning = self._warnings[key]
            self._publish("trouble", warning.message, key, run, code=warning.code, action=warning.action)
        for what, which in [key for key in before if key not in self._warnings]:
            if isinstance(which, str):
                self._publish("calibration", f"{_light(which)} is as bright as before again.", (what, which), run)
            elif what == "drift":
                message = f"Camera {self._names[which]} is back at its calibrated position."
                self._publish("calibration", message, (what, which), run)

    def _publish(self, kind: str, message: str, key: tuple[str, int | str], run: str, **rest: str) -> None:
        subject = {"camera": self._names[key[1]]} if isinstance(key[1], int) else {}
        self._events.add(kind, message, run=run, subject=subject, **rest)

    def _evaluate(self) -> None:
        checks = [*self._first, *self._latest]
        new = self._calibration.uncalibrated
        self._exchanges = self._exchanged(new) if new else {}
        self._drifts = {drift.camera: drift for drift in find_drifts(checks) if drift.camera not in new}
        self._warnings: dict[tuple[str, int | str], Reason] = {
            **{("drift", camera): self._drifted(drift) for camera, drift in self._drifts.items()},
            **{("unseen", camera): self._unseen(camera) for camera in find_vanished_cameras(checks)},
            **{("exchanged", camera): self._uncalibrated(camera, found) for camera, found in self._exchanges.items()},
            **{("dim", lamp.light): self._dim(lamp) for lamp in find_dim_lamps(checks)},
        }

    def _exchanged(self, new: tuple[int, ...]) -> dict[int, CameraExchange]:
        """Return for every exchanged camera what the boards since then show."""
        count = len(self._first) + len(self._latest)
        try:
            proposal = self.proposal()
        except InputError as refusal:
            # Without a board nothing is wrong yet.
            why = (refusal.message, refusal.action or "") if count else ("", "")
            return {camera: CameraExchange(boards=count, ready=False, message=why[0], action=why[1]) for camera in new}
        found = {}
        for camera in new:
            x, y, turn = (round(float(v), 3) for v in proposal.found.displacement_px[camera])
            sigma_px = round(float(proposal.found.sigma_px[camera].max()), 4)
            found[camera] = CameraExchange(boards=count, ready=True, x_px=x, y_px=y, turn_px=turn, sigma_px=sigma_px)
        return found

    def _uncalibrated(self, camera: int, found: CameraExchange) -> Reason:
        name = self._names[camera]
        ready = f" {found.boards} board(s) show where it hangs, to {found.sigma_px} px." if found.ready else ""
        return Reason(
            code="camera-not-calibrated",
            message=f"Camera {name} was exchanged and is not calibrated yet: every run is degraded.{ready}",
            action=(
                "Confirm its calibration on the page Cameras."
                if found.ready
                else "Let a board pass, then confirm its calibration on the page Cameras; or use the calibration board."
            ),
        )

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
        try:
            kept = KeptBaselines.model_validate_json(self._kept.baselines() or "")
        except ValidationError:  # none, or of another version
            return ()
        return kept.types if kept.calibration == self.digest else ()

    def _drifted(self, d: Drift) -> Reason:
        name, seen = self._names[d.camera], "1 board shows it" if d.runs == 1 else f"{d.runs} boards show it"
        # Links between two neighbouring cameras show only their relative displacement, not which of the two has moved.
        instead = "".join(f" (or {self._names[i]} the other way)" for i in d.instead)
        return Reason(
            code="calibration-drift",
            message=f"Camera {name}{instead} is displaced by {d.size_px:.2f} px from its calibration since run "
            f"{d.since_run} ({d.since_time}); {seen}.",
            action=f"Call the engineer: check whether camera {name} is loose or was knocked; then calibrate, or adopt "
            "what `vaoi recalibrate` proposes.",
        )

    def _unseen(self, camera: int) -> Reason:
        name = self._names[camera]
        return Reason(
            code="calibration-unseen",
            message=f"The last {VANISHED_RUNS} boards show nothing of camera {name}'s position: it no longer sees what "
            "its neighbours see.",
            action=f"Call the engineer: check whether camera {name} was knocked, is covered or out of focus.",
        )

    def _dim(self, lamp: DimLamp) -> Reason:
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

    def _camera(self, i: int) -> CameraCalibration:
        shown, drift = [*self._first, *self._latest][-HISTORY_RUNS:], self._drifts.get(i)
        recent = shown[-_UNSEEN_RUNS:]
        state = "unknown" if not recent else "steady" if any(c.cameras[i].seen for c in recent) else "unseen"
        return CameraCalibration(
            camera=i,
            name=self._names[i],
            state="drifted" if drift is not None else state,
            drift=None if drift is None else _drift_of(drift),
            history=tuple(_moment(check, i) for check in shown),
            exchange=self._exchanges.get(i),
        )


def _baselines_of(check: RunCheck | None) -> list[tuple[int, str, LampBaseline | None]]:
    return [] if check is None else sorted(((p.camera, p.light, p.baseline) for p in check.lamps), key=str)


def _light(name: str) -> str:
    return f"Light {name}" if name else "The light"


def _drift_of(d: Drift) -> CameraDrift:
    x, y, turn = (round(v, 4) for v in d.displacement_px)
    size, since = round(d.size_px, 4), d.since_time
    return CameraDrift(
        size_px=size, x_px=x, y_px=y, turn_px=turn, since_run=d.since_run, since=since, runs=d.runs, instead=d.instead
    )


def _moment(check: RunCheck, camera: int) -> CameraMoment:
    seen = check.cameras[camera]
    same = {key: getattr(seen, key) for key in ("x_px", "y_px", "turn_px", "rms_px", "links", "fiducials")}
    return CameraMoment(run=check.run, time=check.time, sigma_px=max(seen.sigma_px), **same)


def _parsed(text: str, cameras: int) -> RunCheck | None:
    """Return a stored check; None if it is damaged or of another version. No row may prevent the station's start."""
    try:
        check = RunCheck.model_validate_json(text)
    except ValidationError:
        return None
    named = (*check.rivals, *(lamp.camera for lamp in check.lamps))
    fits = len(check.cameras) == cameras and all(0 <= camera < cameras for camera in named)
    return check if fits else None
