"""A trial of a calibration: made from a run of the station, judged by a person, accepted or not.

A trial takes seconds. It is kept here, so that a page that is loaded anew finds it again.
"""

from __future__ import annotations

import json
import logging
import math
import threading
from collections.abc import Callable
from typing import Any

import cv2

from vaoi_station.api.setup.design import nominal_heads
from vaoi_station.api.setup.models import CalibrationTrial, TrialCamera, TrialNote, TrialRequest
from vaoi_station.api.setup.station_files import StationFiles, replace_with_backup
from vaoi_station.calibration import Limits, Outcome, calibrate
from vaoi_station.calibration.calibration_difference import CalibrationDifference, compare_calibrations
from vaoi_station.calibration.pictures.calibration_picture import draw_calibration
from vaoi_station.calibration.pictures.difference_picture import draw_difference
from vaoi_station.errors import InputError, InternalError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.files.images import Image
from vaoi_station.model import Calibration, CameraHead
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.run_ids import utc

_log = logging.getLogger(__name__)
_RUNNING = ("reading", "fitting")


class Trials:
    """The latest trial. Methods may be called from any thread; `perform` takes seconds."""

    def __init__(self, coordinator: StationCoordinator, files: StationFiles) -> None:
        self._coordinator, self._files = coordinator, files
        self._lock = threading.Lock()
        self._trial = CalibrationTrial(state="none")
        self._made: Calibration | None = None
        self._accepting = False
        """Whether the file of the station is being replaced, during which no other trial begins or is accepted."""
        self._pictures: dict[str, bytes] = {}

    def status(self) -> CalibrationTrial:
        """Return the latest trial."""
        with self._lock:
            return self._trial

    def begin(self, wanted: TrialRequest) -> CalibrationTrial:
        """Begin a trial, which `perform` must make; refuse it while another one is made or boards are awaited."""
        if self._coordinator.snapshot().armed_with is not None:
            # A fit takes a core for seconds, and the next board must not miss it.
            raise StateError("The line is armed.", action="Disarm it, then calibrate.", code="line-armed")
        if wanted.flatness_um and wanted.working_distance_mm is None:
            raise InputError(
                "body: flatness_um is given without working_distance_mm, by which a height moves a picture.",
                action="Give the distance of the cameras from the board.",
            )
        self._heads(wanted)
        run = self._coordinator.run(wanted.run)
        if wanted.row >= run.rows:
            raise InputError.field("body", "row", wanted.row, f"below {run.rows}, the rows of run {run.id}")
        with self._lock:
            self._require_rest()
            self._made, self._pictures = None, {}
            self._trial = CalibrationTrial(
                state="reading", run=wanted.run, row=wanted.row, begun=utc(), frames=len(self._files.config.cameras)
            )
            return self._trial

    def perform(self, wanted: TrialRequest) -> None:
        """Make the trial that was begun. What it refuses, and any fault, is stated in its status."""
        try:
            self._perform(wanted)
        except VaoiError as error:
            self._change(state="refused", message=error.message, action=error.action)
        except Exception:  # noqa: BLE001  (the trial must end, or no other could begin; the log has the cause)
            _log.exception("the trial of a calibration failed")
            self._change(state="refused", message="The trial failed; the log of the station has the cause.")

    def accept(self) -> CalibrationTrial:
        """Write the calibration of the trial to the file of the station, which keeps a copy of the one before.

        It is in force from the next start of the station on. If the file cannot be written, nothing is changed, and
        the trial can be accepted again.
        """
        with self._lock:
            self._require_rest()
            if self._made is None or self._trial.state != "judged":
                raise StateError("There is no trial to accept.", action="Make one.", code="no-trial")
            made, run = self._made, self._trial.run
            self._accepting = True
        # The disk may take long: meanwhile the lock is free, so that the status is returned.
        accepted: dict[str, Any] = {}
        try:
            path = self._files.config.calibration
            text = json.dumps(made.model_dump(mode="json", exclude_none=True), indent=1, allow_nan=False) + "\n"
            backup = replace_with_backup(path, text.encode())
            accepted = {"state": "accepted", "accepted_as": path.name, "backup": backup}
            _log.info("the calibration from run %s was accepted as %s", run, path)
        finally:
            # One step, so that no caller finds a trial that is neither being accepted nor accepted.
            with self._lock:
                self._accepting = False
                self._trial = trial = self._trial.model_copy(update=accepted)
        return trial

    def discard(self) -> CalibrationTrial:
        """Forget the latest trial, with its calibration and its pictures."""
        with self._lock:
            self._require_rest()
            self._made, self._pictures = None, {}
            self._trial = CalibrationTrial(state="none")
            return self._trial

    def document(self) -> bytes:
        """Return the calibration of the trial as a file."""
        with self._lock:
            if self._made is None:
                raise NotFoundError("There is no calibration: no trial has ended well.", code="no-trial")
            return (json.dumps(self._made.model_dump(mode="json", exclude_none=True), indent=1) + "\n").encode()

    def picture(self, name: str) -> bytes:
        """Return a picture of the trial, JPEG: `marks` or `difference`."""
        with self._lock:
            if name not in self._pictures:
                raise NotFoundError(f"The trial has no picture {name!r}.", code="no-trial")
            return self._pictures[name]

    def _require_rest(self) -> None:
        """Raise StateError while a trial is made or accepted; the caller holds the lock."""
        if self._accepting or self._trial.state in _RUNNING:
            doing = "accepted" if self._accepting else "made"
            raise StateError(f"A trial is being {doing}.", action="Wait until it ends.", code="trial-running")

    def _perform(self, wanted: TrialRequest) -> None:
        heads = self._heads(wanted)
        limits = Limits(
            wanted.residual_limit_px,
            wanted.working_distance_mm,
            wanted.center_tolerance_mm,
            wanted.mark_accuracy_um / 1000,
            wanted.flatness_um / 1000,
        )
        outcome = calibrate(heads, self._reader(wanted, len(heads)), wanted.layout, limits)
        self._add_picture("marks", draw_calibration(outcome))
        if outcome.refused:
            error = outcome.error()
            self._change(
                state="refused",
                cameras=self._cameras(outcome),
                notes=_notes(outcome),
                message=error.message,
                action=error.action,
            )
            return
        made = outcome.calibration()
        before = self._in_force()
        difference = None if before is None else compare_calibrations(made, before, heads)
        found: dict[str, Any] = {}
        if difference is not None and before is not None:
            self._add_picture("difference", draw_difference(difference, heads))
            x, y = (round(float(v), 4) for v in difference.shift_mm)
            found = {
                "shift_mm": (x, y),
                "turned_deg": round(math.degrees(difference.angle_rad), 5),
                "in_force_created": before.created,
            }
        with self._lock:
            self._made = made
        self._change(state="judged", cameras=self._cameras(outcome, difference), notes=_notes(outcome), **found)

    def _heads(self, wanted: TrialRequest) -> tuple[CameraHead, ...]:
        """Return the cameras with nominal views; refuse a request for an array of which they are unknown."""
        return nominal_heads([c.head for c in self._files.config.cameras], wanted.pitch_mm, wanted.px_per_mm)

    def _reader(self, wanted: TrialRequest, cameras: int) -> Callable[[int], Image | None]:
        def frame(camera: int) -> Image | None:
            pixels, _ = self._coordinator.frame(wanted.run, camera, wanted.row)
            self._change(frames_read=camera + 1, state="fitting" if camera + 1 == cameras else "reading")
            return pixels

        return frame

    def _in_force(self) -> Calibration | None:
        """Return the calibration of the station's file; None if it cannot be read, which a new one mends."""
        try:
            return read_calibration(self._files.config.calibration, len(self._files.config.cameras))
        except VaoiError:
            return None

    def _cameras(self, outcome: Outcome, difference: CalibrationDifference | None = None) -> list[TrialCamera]:
        return [
            TrialCamera(
                camera=c.camera,
                name=self._files.config.cameras[c.camera].name,
                marks=len(c.marks),
                used=c.used,
                residual_px=None if c.fit is None else round(c.fit.rms_px, 5),
                corner_sigma_px=None if c.fit is None else round(c.corner_sigma_px, 4),
                distortion_px=round(float(c.fit.lens_px[0]), 4) if c.fit is not None and c.lens_known else None,
                changed_px=None if difference is None else round(difference.rms_px[c.camera], 4),
                refusal=c.refusal or None,
                action=c.action or None,
            )
            for c in outcome.cameras
        ]

    def _add_picture(self, name: str, picture: Image) -> None:
        encoded, content = cv2.imencode(".jpg", picture)
        if not encoded:
            raise InternalError(f"the picture {name} cannot be encoded")
        with self._lock:
            self._pictures[name] = content.tobytes()

    def _change(self, **values: Any) -> CalibrationTrial:
        with self._lock:
            self._trial = self._trial.model_copy(update=values)
            return self._trial


def _notes(outcome: Outcome) -> list[TrialNote]:
    return [TrialNote(code=note.code, message=note, values=dict(note.values)) for note in outcome.notes]
