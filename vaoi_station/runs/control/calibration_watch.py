"""Watching the calibration: after every run a worker tells how the cameras stood, and a drift becomes a warning.

Nobody waits for it: it is the last and least of a run's jobs, given out when its result has been told.
Confined to the coordinator's thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Protocol

from vaoi_station.drift.checks import CameraCheck, RunCheck
from vaoi_station.drift.evidence import subsample_links
from vaoi_station.drift.watch import VANISHED_RUNS, Drift, find_drifts, find_vanished_cameras
from vaoi_station.errors import StateError
from vaoi_station.model import Calibration
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus, CameraCalibration, CameraDrift, CameraMoment
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.workers.jobs import CheckJob, Reply
from vaoi_station.store.calibration_checks import CalibrationChecks
from vaoi_station.store.documents import digest_of

FIRST, LATEST = 50, 200
"""Checks that are looked at: of when the calibration was new, and of late."""
SHOWN = 50
"""Runs in the history of a camera."""
_UNSEEN = 5
"""Runs in a row that tell nothing of a camera."""
CODE = "calibration-drift"


class Workers(Protocol):
    """What the watch needs of the pool of workers."""

    def submit(self, job: CheckJob) -> None:
        """Have a job done; its answer comes as an event."""


class CalibrationWatch:
    """The calibration in force and what runs have told of it."""

    def __init__(
        self, checks: CalibrationChecks, events: EventLog, calibration: Calibration, names: Sequence[str]
    ) -> None:
        self._kept, self._events, self._names = checks, events, tuple(names)
        self.digest = digest_of(calibration.model_dump_json())
        self._created = calibration.created
        self._requested: dict[str, str] = {}
        """Digests of the calibrations that runs under check were stitched with, by run."""
        known = [RunCheck.model_validate_json(text) for text in checks.documents(self.digest, FIRST, LATEST)]
        self._first, self._latest = known[:FIRST], deque(known[FIRST:], LATEST)
        self._runs = checks.count(self.digest)
        self._drifts, self._vanished = find_drifts(known), find_vanished_cameras(known)

    def check(self, progress: Progress, workers: Workers) -> None:
        """Have a finished run's evidence checked by a worker."""
        stitch, film = progress.without_components, progress.film
        if stitch is None or film is None or len(self._names) < 2:
            return
        evidence = tuple(subsample_links(linked.evidence) for linked in progress.canonical.values())
        job = CheckJob(
            run=progress.run,
            time=utc(),
            board_type=progress.order.board_type_digest,
            setup=progress.order.setup,
            times_s=tuple(film.head.row_times_s().tolist()),
            evidence=evidence,
            stitch=stitch,
        )
        self._requested[progress.run] = progress.order.calibration_digest
        workers.submit(job)

    def warnings(self) -> tuple[Reason, ...]:
        """What the operator should know of the calibration."""
        drifted = [Reason(code=CODE, message=self._said(d), action=self._advice(d)) for d in self._drifts]
        return (*drifted, *(self._unseen(camera) for camera in self._vanished))

    def status(self) -> CalibrationStatus:
        """All there is to say of the calibration in force."""
        return CalibrationStatus(
            digest=self.digest,
            created=self._created,
            runs=self._runs,
            cameras=tuple(self._camera(i) for i in range(len(self._names))),
        )

    def checked(self, job: CheckJob, answer: Reply) -> None:
        """Keep the outcome of a check, and publish what it changes."""
        run, digest = job.run, self._requested.pop(job.run)
        if answer.error is not None:
            if not isinstance(answer.error, StateError):  # a station that stops does no more checks
                self._events.add("trouble", answer.error.message, run=run, code="calibration-not-checked")
            return
        check: RunCheck = answer.value
        self._kept.save(run, digest, check.model_dump_json())
        if digest != self.digest:
            return
        self._runs += 1
        (self._first if len(self._first) < FIRST else self._latest).append(check)
        checks = [*self._first, *self._latest]
        before, gone = self._drifts, self._vanished
        self._drifts, self._vanished = find_drifts(checks), find_vanished_cameras(checks)
        for camera in sorted({*self._vanished} - {*gone}):
            reason = self._unseen(camera)
            self._events.add("trouble", reason.message, run=run, code=reason.code, action=reason.action)
        self._tell(before, run)

    def _tell(self, before: tuple[Drift, ...], run: str) -> None:
        """New drifts, and those that are over, as events."""
        known, now = {d.camera for d in before}, {d.camera for d in self._drifts}
        for d in self._drifts:
            if d.camera not in known:
                self._events.add("trouble", self._said(d), run=run, code=CODE, action=self._advice(d))
        for camera in sorted(known - now):
            name = self._names[camera]
            self._events.add("calibration", f"Camera {name} looks where it was calibrated again.", run=run)

    def _unseen(self, camera: int) -> Reason:
        name = self._names[camera]
        return Reason(
            code="calibration-unseen",
            message=f"The last {VANISHED_RUNS} boards tell nothing of where camera {name} looks; it saw what its "
            "neighbours see, and no longer does.",
            action=f"Call the engineer: see whether camera {name} was knocked, is covered or out of focus.",
        )

    def _said(self, d: Drift) -> str:
        seen = "1 board" if d.runs == 1 else f"{d.runs} boards"
        instead = "".join(f" (or {self._names[i]} the other way)" for i in d.instead)
        return (
            f"Camera {self._names[d.camera]}{instead} looks {d.size_px:.2f} px beside where it was calibrated, since "
            f"run {d.since_run} ({d.since_time}); {seen} show it."
        )

    def _advice(self, d: Drift) -> str:
        return (
            f"Call the engineer: see whether camera {self._names[d.camera]} is loose or was knocked; then calibrate, "
            "or take over what `vaoi recalibrate` proposes."
        )

    def _camera(self, i: int) -> CameraCalibration:
        shown = [*self._first, *self._latest][-SHOWN:]
        drift = next((d for d in self._drifts if d.camera == i), None)
        recent = shown[-_UNSEEN:]
        state = "unknown" if not recent else "steady" if any(c.cameras[i].seen for c in recent) else "unseen"
        return CameraCalibration(
            camera=i,
            name=self._names[i],
            state="drifted" if drift is not None else state,
            drift=None if drift is None else _shown(drift),
            history=tuple(_moment(check, check.cameras[i]) for check in shown),
        )


def _shown(d: Drift) -> CameraDrift:
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
