"""Calibration over REST: artwork of the board, the marks of a frame, and a trial that a person accepts or not.

All of it needs the scope admin. A trial takes seconds; it is kept here, so that a page that is loaded anew finds it.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, Field, model_validator

from vaoi_station.api.http_caching import json_of
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import file_reply, rest_router
from vaoi_station.api.routes.cameras import CameraTrials
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.station_files import StationFiles, content_of, replace_with_backup
from vaoi_station.calibration import Limits, Outcome, calibrate
from vaoi_station.calibration.artwork import ArrayDesign, Board, design_board
from vaoi_station.calibration.artwork.artwork_files import RENDERERS, array_of, artwork_title
from vaoi_station.calibration.calibration_difference import CalibrationDifference, compare_calibrations
from vaoi_station.calibration.exchanged_camera import with_camera
from vaoi_station.calibration.mark_detection import MarkAppearance, detect_marks
from vaoi_station.calibration.nominal_view import is_in_frame, nominal_matrix
from vaoi_station.calibration.pictures.calibration_picture import draw_calibration
from vaoi_station.calibration.pictures.difference_picture import draw_difference
from vaoi_station.errors import InputError, InternalError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.files.calibrations import Layout
from vaoi_station.files.images import Image
from vaoi_station.geometry.transforms import apply
from vaoi_station.model import Calibration, CameraHead, Strict
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.run_ids import utc

_log = logging.getLogger(__name__)
_RUNNING = ("reading", "fitting")
_SMALLEST_PX = 5.0
"""Size of the smallest marks that are searched; noise looks like smaller ones."""
_LAID_MM = 2.0
"""How far from its place a board may be laid: marks nearer to the edge of a view, also of neighbours, may be cut."""
_MEDIA = {"svg": "image/svg+xml", "pdf": "application/pdf", "gbr": "application/octet-stream"}
_SVG_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox"
DOCUMENT: dict[int | str, dict[str, Any]] = {
    200: {"description": "The calibration.", "content": {"application/json": {"schema": {"type": "object"}}}}
}
ArtworkFile = Literal[
    "calibration-board.svg", "calibration-board.pdf", "calibration-board.gbr", "calibration-board-outline.gbr"
]
TrialState = Literal["none", "reading", "fitting", "judged", "refused", "accepted"]


_UNSTATED = ", where station.toml states none."
Pitch = Annotated[float | None, Field(gt=0, le=10_000, description=f"Distance of neighbouring cameras{_UNSTATED}")]
PxPerMm = Annotated[float | None, Field(ge=0.1, le=1000, description=f"Resolution of the cameras{_UNSTATED}")]
Micrometres = Annotated[float, Field(ge=0, le=10_000)]
BoardLayout = Annotated[
    Layout, Field(description="The marks of the calibration board: the `layout.json` of its artwork.")
]


class ArtworkOptions(BaseModel):
    """The marks of a calibration board; what is absent is nominal in station.toml."""

    columns: int = Field(default=5, ge=2, le=50, description="Marks in each view, across.")
    rows: int = Field(default=4, ge=2, le=50, description="Marks in each view, down.")
    mark_mm: float = Field(default=2.0, ge=0.1, le=50, description="Size of a mark.")
    tolerance_mm: float = Field(default=3.0, ge=0, le=50, description="Distance of marks from the edge of a view.")
    light_marks: bool = Field(default=False, description="Light marks on a dark board.")
    pitch_mm: float | None = Field(default=None, gt=0, le=10_000, description="Distance of neighbouring cameras.")
    px_per_mm: float | None = Field(default=None, ge=0.1, le=1000, description="Resolution of the cameras.")


class TrialRequest(Strict):
    """A request to calibrate the array from one row of a run that shows the calibration board."""

    run: str = Field(min_length=1, max_length=64, description="Id of a run whose frames can still be read.")
    row: int = Field(ge=0, le=100_000, description="The row in which every camera sees its marks.")
    layout: BoardLayout
    camera: int | None = Field(
        default=None,
        ge=0,
        le=1000,
        description="Calibrate this camera alone, as an exchanged one, and hold the others.",
    )
    pitch_mm: Pitch = None
    px_per_mm: PxPerMm = None
    residual_limit_px: float = Field(
        default=0.2, gt=0, le=100, description="Largest accepted rms residual of a camera."
    )
    working_distance_mm: float | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="Height of the cameras above the board; absent: heights have no parallax.",
    )
    center_tolerance_mm: float = Field(
        default=2.0, gt=0, le=1000, description="Accuracy of nominal_center_mm to the board as it lies."
    )
    mark_accuracy_um: Micrometres = Field(default=0.0, description="Standard deviation of places of marks.")
    flatness_um: Micrometres = Field(
        default=0.0, description="Standard deviation of the board's height; needs working_distance_mm."
    )


class TrialCamera(BaseModel):
    """What a trial has found for one camera."""

    camera: int
    name: str
    marks: int = Field(description="Marks of the layout that are expected in its frame.")
    used: int = Field(description="Marks in the fit.")
    residual_px: float | None = Field(default=None, description="Root mean square of the residuals.")
    corner_sigma_px: float | None = Field(default=None, description="Standard deviation at the worst corner.")
    distortion_px: float | None = Field(
        default=None, description="Distortion at the corner, if the marks determine it."
    )
    changed_px: float | None = Field(
        default=None, description="Root mean square difference to the calibration in force, the board's motion removed."
    )
    refusal: str | None = Field(default=None, description="Why this camera cannot be calibrated.")
    action: str | None = Field(default=None, description="What removes the cause of the refusal.")


class TrialNote(BaseModel):
    """A warning of a trial of a calibration."""

    code: str
    message: str
    values: dict[str, str] = Field(description="What the message states: numbers of cameras, places, lengths.")


class CalibrationTrial(BaseModel):
    """The latest trial of a calibration. It is kept until the next one begins or the station is restarted."""

    state: TrialState
    run: str | None = None
    row: int | None = None
    camera: int | None = Field(default=None, description="The only camera that is calibrated; absent: all are.")
    begun: str | None = None
    frames_read: int = 0
    frames: int = Field(default=0, description="Number of frames that are read: one for each camera.")
    cameras: list[TrialCamera] = []
    notes: list[TrialNote] = []
    message: str | None = Field(default=None, description="Why it was refused.")
    action: str | None = None
    shift_mm: tuple[float, float] | None = Field(
        default=None, description="How the calibration board lies displaced against the calibration in force."
    )
    turned_deg: float | None = None
    in_force_created: str | None = Field(default=None, description="When the calibration in force was made.")
    accepted_as: str | None = Field(default=None, description="Name of the file that was written.")
    backup: str | None = Field(default=None, description="Name of the copy of the file before.")


class MarksRequest(Strict):
    """A request to search one frame, of a run or of a trial of the camera, for the marks of a calibration board."""

    run: str | None = Field(
        default=None, min_length=1, max_length=64, description="Id of a run whose frames can still be read."
    )
    row: int | None = Field(default=None, ge=0, le=100_000, description="Row of the run, from 0.")
    trial: int | None = Field(
        default=None, ge=1, le=10**9, description="Number of the newest trial of the camera, in place of run and row."
    )
    camera: int = Field(ge=0, le=1000, description="Camera, from 0.")
    layout: BoardLayout
    pitch_mm: Pitch = None
    px_per_mm: PxPerMm = None

    @model_validator(mode="after")
    def _names_one_frame(self) -> MarksRequest:
        given = self.run is not None, self.row is not None, self.trial is not None
        if given not in ((True, True, False), (False, False, True)):
            raise ValueError("must have either run and row, or trial")
        return self


class FoundMarks(BaseModel):
    """The marks that a frame shows, and how many it should."""

    width: int
    height: int
    found: list[tuple[float, float]] = Field(description="Where marks like those of the layout are, raw pixels.")
    expected: int = Field(description="Marks of the layout that are in view even if the board lies 2 mm off.")
    blur_px: float = Field(description="Blur of their edges, as a standard deviation.")


def router(services: Services, files: StationFiles, camera_trials: CameraTrials) -> APIRouter:
    """Create the routes. All of them need the scope admin."""
    routes = rest_router(prefix="/calibration", tags=["setup"])
    trials, ask = Trials(services.coordinator, files), services.commands.ask
    # One trial at a time, in a thread of its own: commands do not wait for it.
    making, searching = ThreadLimit(1), ThreadLimit(1)
    under_way = set[asyncio.Task[None]]()

    def board(options: ArtworkOptions) -> tuple[Board, str]:
        made = design_of(files, options)
        designed = design_board(made)
        return designed, artwork_title(designed, made.pitch_mm)

    @routes.get("/artwork/{file}", response_class=Response, responses=file_reply("The file.", *_MEDIA.values()))
    async def get_calibration_artwork(
        file: Annotated[ArtworkFile, Path(description="Name of the file.")], options: Annotated[ArtworkOptions, Query()]
    ) -> Response:
        """Return a file of the artwork of a calibration board for the cameras of this station, to print at 1:1.

        Vector graphics for printers have the number of each camera and an arrow along them.
        """
        content = await ask(lambda: RENDERERS[file](*board(options)))
        headers = {"Content-Security-Policy": _SVG_POLICY}
        return Response(content, media_type=_MEDIA[file.rpartition(".")[2]], headers=headers)

    @routes.get("/layout", response_model=Layout)
    async def get_calibration_layout(options: Annotated[ArtworkOptions, Query()]) -> Response:
        """Return the places of the marks of the artwork that the same parameters give: its `layout.json`."""
        designed, _ = await ask(board, options)
        return Response(json_of(designed.layout), media_type="application/json")

    @routes.post("/marks")
    async def find_calibration_marks(wanted: MarksRequest) -> FoundMarks:
        """Search one frame for the marks of a calibration board: whether the camera shows what it should.

        It is a frame of a run, or while the board is being laid one of `cameras/{camera}/trial`.
        One frame at a time is searched, so that boards are not held up.
        """
        return await searching.ask(find_marks, services.coordinator, camera_trials, files, wanted)

    @routes.get("/trial")
    async def get_calibration_trial() -> CalibrationTrial:
        """Return the latest trial of a calibration: how far it is, or what it has found."""
        return trials.status()

    @routes.post("/trial", status_code=202)
    async def begin_calibration_trial(wanted: TrialRequest) -> CalibrationTrial:
        """Calibrate the array from one row of a run that shows the calibration board, and reply at once.

        `GET calibration/trial` states how far it is. Nothing is changed until it is accepted. 409 `line-armed`: the
        line is armed; 409 `trial-running`: another trial is being made; 409 `camera-exchanged`: a camera was exchanged
        after the run.
        """
        begun = await ask(trials.begin, wanted)
        task = asyncio.create_task(making.ask(trials.perform, wanted))
        # The event loop keeps only weak references to tasks.
        under_way.add(task)
        task.add_done_callback(under_way.discard)
        return begun

    @routes.delete("/trial")
    async def discard_calibration_trial() -> CalibrationTrial:
        """Discard the latest trial, which cannot be accepted afterwards; what was accepted before stays.

        409 `trial-running`: one is being made, or accepted by another caller.
        """
        return await ask(trials.discard)

    @routes.post("/trial/accept")
    async def accept_calibration_trial() -> CalibrationTrial:
        """Replace the calibration file of the station by that of the trial; a copy of the one before is kept.

        It is in force from the next start of the station on; that of one camera alone at once, while the line is
        disarmed (409 `line-armed`). 409 `no-trial`: no trial has ended well; 409
        `trial-running`: one is being made, or accepted by another caller; 409 `settings-read-only`: the service may
        not write the file.
        """
        return await ask(trials.accept)

    @routes.get("/trial/calibration", response_class=Response, responses=DOCUMENT)
    async def get_trial_calibration() -> Response:
        """Return the calibration of the trial as a file, in the format of `docs/formats.md`."""
        return Response(await ask(trials.document), media_type="application/json")

    @routes.get(
        "/trial/pictures/{picture}", response_class=Response, responses=file_reply("The picture.", "image/jpeg")
    )
    async def get_trial_picture(
        picture: Annotated[
            Literal["marks", "difference"],
            Path(description="The marks, or the difference to the calibration in force."),
        ],
    ) -> Response:
        """Return a picture of the trial: the marks that were found, or the difference to the calibration in force."""
        return Response(await ask(trials.picture, picture), media_type="image/jpeg")

    return routes


def design_of(files: StationFiles, options: ArtworkOptions) -> ArrayDesign:
    """Return the array for which a calibration board is made; raise InputError if a nominal value is missing."""
    heads = [camera.head for camera in files.config.cameras]
    pitch, field = array_of(heads, options.px_per_mm)
    pitch = options.pitch_mm or pitch or (1.0 if len(heads) == 1 else None)
    if pitch is None or field is None:
        raise nominal_values_missing(pitch_mm=pitch, px_per_mm=field)
    return ArrayDesign(
        len(heads),
        pitch,
        field,
        options.columns,
        options.rows,
        options.mark_mm,
        tolerance_mm=options.tolerance_mm,
        polarity="light" if options.light_marks else "dark",
    )


class Trials:
    """The latest trial. Methods may be called from any thread; `perform` takes seconds."""

    def __init__(self, coordinator: StationCoordinator, files: StationFiles) -> None:
        self._coordinator, self._files = coordinator, files
        self._lock = threading.Lock()
        self._trial = CalibrationTrial(state="none")
        self._made: Calibration | None = None
        self._made_beside: bytes | None = None
        """Content of the station's calibration file when the trial was made; None if it could not be read."""
        self._accepting = False
        """Whether the file of the station is being replaced, during which no other trial begins or is accepted."""
        self._pictures: dict[str, bytes] = {}

    def status(self) -> CalibrationTrial:
        """Return the latest trial."""
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
        nominal_heads(self._files, wanted)
        run = self._coordinator.run(wanted.run)
        if wanted.camera is not None and wanted.camera >= len(self._files.config.cameras):
            limit = f"below {len(self._files.config.cameras)}, the cameras of the station"
            raise InputError.field("body", "camera", wanted.camera, limit)
        if wanted.row >= run.rows:
            raise InputError.field("body", "row", wanted.row, f"below {run.rows}, the rows of run {run.id}")
        for place, filmed in zip(self._files.config.cameras, self._coordinator.camera_serials(run.id), strict=False):
            if place.serial not in (None, filmed):
                before = filmed or "of unknown serial number"
                raise StateError(
                    f"Run {run.id} was filmed with camera {before} at place {place.name}, where {place.serial} is now.",
                    action="Film the board of marks again.",
                    code="camera-exchanged",
                )
        frames = len(self._files.config.cameras)
        begun = {"run": wanted.run, "row": wanted.row, "camera": wanted.camera, "begun": utc(), "frames": frames}
        return self._replace(state="reading", **begun)

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

        If the file cannot be written, nothing is changed, and the trial can be accepted again.
        """
        with self._lock:
            self._require_rest()
            if self._made is None or self._trial.state != "judged":
                raise StateError("There is no trial to accept.", action="Make one.", code="no-trial")
            if self._in_force() != self._made_beside:
                raise StateError(
                    "The calibration in force was replaced after this trial was made, so that it no longer holds.",
                    action="Make another trial.",
                    code="no-trial",
                )
            made, run, alone = self._made, self._trial.run, self._trial.camera is not None
            self._accepting = True
        # The disk may take long: meanwhile the lock is free, so that the status is returned.
        accepted: dict[str, Any] = {}
        try:
            if alone:
                self._coordinator.require_disarmed()
            path = self._files.config.calibration
            backup = replace_with_backup(path, content_of(made))
            accepted = {"state": "accepted", "accepted_as": path.name, "backup": backup}
            if alone:
                self._coordinator.use_calibration(made)
            _log.info("the calibration from run %s was accepted as %s", run, path)
        finally:
            # One step, so that no caller finds a trial that is neither being accepted nor accepted.
            with self._lock:
                self._accepting = False
                self._trial = trial = self._trial.model_copy(update=accepted)
        return trial

    def discard(self) -> CalibrationTrial:
        """Forget the latest trial, with its calibration and its pictures."""
        return self._replace(state="none")

    def document(self) -> bytes:
        """Return the calibration of the trial as a file."""
        if (made := self._made) is None:
            raise NotFoundError("There is no calibration: no trial has ended well.", code="no-trial")
        return content_of(made)

    def picture(self, name: str) -> bytes:
        """Return a picture of the trial, JPEG: `marks` or `difference`."""
        picture = self._pictures.get(name)
        if picture is None:
            raise NotFoundError(f"The trial has no picture {name!r}.", code="no-trial")
        return picture

    def _in_force(self) -> bytes | None:
        """Return the content of the station's calibration file; None if it cannot be read."""
        try:
            return self._files.config.calibration.read_bytes()
        except OSError:
            return None

    def _require_rest(self) -> None:
        """Raise StateError while a trial is made or accepted; the caller holds the lock."""
        if self._accepting or self._trial.state in _RUNNING:
            doing = "accepted" if self._accepting else "made"
            raise StateError(f"A trial is being {doing}.", action="Wait until it ends.", code="trial-running")

    def _replace(self, **values: Any) -> CalibrationTrial:
        with self._lock:
            self._require_rest()
            self._made, self._pictures = None, {}
            self._trial = CalibrationTrial(**values)
            return self._trial

    def _change(self, **values: Any) -> None:
        with self._lock:
            self._trial = self._trial.model_copy(update=values)

    def _perform(self, wanted: TrialRequest) -> None:
        heads = nominal_heads(self._files, wanted)
        limits = Limits(
            wanted.residual_limit_px,
            wanted.working_distance_mm,
            wanted.center_tolerance_mm,
            wanted.mark_accuracy_um / 1000,
            wanted.flatness_um / 1000,
        )

        def frame(camera: int) -> Image | None:
            pixels, _ = self._coordinator.frame(wanted.run, camera, wanted.row)
            self._change(frames_read=camera + 1, state="fitting" if camera + 1 == len(heads) else "reading")
            return pixels

        outcome = calibrate(heads, frame, wanted.layout, limits)
        notes = [TrialNote(code=note.code, message=note, values=dict(note.values)) for note in outcome.notes]
        self._pictures["marks"] = _jpeg(draw_calibration(outcome))
        if outcome.refused:
            error = outcome.error()
            cameras = self._cameras(outcome)
            self._change(state="refused", cameras=cameras, notes=notes, message=error.message, action=error.action)
            return
        made, beside = outcome.calibration(), self._in_force()
        try:
            before = read_calibration(self._files.config.calibration, len(heads))
        except VaoiError:
            before = None  # it cannot be read, which the new one mends
        if wanted.camera is not None:
            if before is None:
                raise StateError("The array is not calibrated.", action="Calibrate all cameras.", code="no-calibration")
            made, _ = with_camera(before, made, heads, wanted.camera)
        difference = (
            None if before is None else compare_calibrations(made, before, heads, one_board=wanted.camera is not None)
        )
        found: dict[str, Any] = {}
        if difference is not None and before is not None:
            self._pictures["difference"] = _jpeg(draw_difference(difference, heads))
            x, y = (round(float(v), 4) for v in difference.shift_mm)
            found = {
                "shift_mm": (x, y),
                "turned_deg": round(math.degrees(difference.angle_rad), 5),
                "in_force_created": before.created,
            }
        self._made, self._made_beside = made, beside
        self._change(state="judged", cameras=self._cameras(outcome, difference), notes=notes, **found)

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


def _jpeg(picture: Image) -> bytes:
    encoded, content = cv2.imencode(".jpg", picture)
    if not encoded:
        raise InternalError("a picture of the trial cannot be encoded")
    return content.tobytes()


def find_marks(
    coordinator: StationCoordinator, trials: CameraTrials, files: StationFiles, wanted: MarksRequest
) -> FoundMarks:
    """Search a frame for marks; refuse a camera that the station does not have, and an array without nominal values."""
    heads = nominal_heads(files, wanted)
    if wanted.camera >= len(heads):
        raise InputError.field("body", "camera", wanted.camera, f"below {len(heads)}, the cameras of the station")
    head, layout = heads[wanted.camera], wanted.layout
    if wanted.run is None or wanted.row is None:
        grey = eight_bit_grey(trials.frame(wanted.camera, wanted.trial))
    else:
        grey = eight_bit_grey(coordinator.frame(wanted.run, wanted.camera, wanted.row)[0])
    scale = head.nominal_px_per_mm or 1.0
    marks = MarkAppearance.of(layout, scale)
    most = min(grey.shape) / 2
    if not _SMALLEST_PX <= marks.size_px <= most:
        size = f"{marks.size_px:.1f} px in a frame"
        raise InputError.field("body", "layout.mark.size", size, f"{_SMALLEST_PX:.0f} … {most:.0f} px")
    detected = detect_marks(grey, marks)
    marks_mm = np.array([(m.x, m.y) for m in layout.marks]) * layout.mm_per_unit
    places_px = apply(nominal_matrix(head, wanted.camera), marks_mm)
    return FoundMarks(
        width=grey.shape[1],
        height=grey.shape[0],
        found=[(round(float(x), 2), round(float(y), 2)) for x, y in detected.px],
        expected=int(is_in_frame(head, places_px, marks.margin_px + _LAID_MM * scale).sum()),
        blur_px=round(detected.blur_px, 2),
    )


def nominal_heads(files: StationFiles, wanted: TrialRequest | MarksRequest) -> tuple[CameraHead, ...]:
    """Return the cameras with nominal views; what is missing follows from an evenly spaced array.

    Camera 0 is then at the origin and the others along x, as on the artwork of a calibration board. InputError: a
    nominal value is neither in station.toml nor in the request.
    """
    heads = [camera.head for camera in files.config.cameras]
    placed = all(head.nominal_center_mm is not None for head in heads)
    scaled = all(head.nominal_px_per_mm is not None for head in heads)
    # The distance of a single camera to its neighbours does not matter.
    pitch = wanted.pitch_mm or (1.0 if placed or len(heads) == 1 else None)
    if pitch is None or not (scaled or wanted.px_per_mm):
        raise nominal_values_missing(pitch_mm=pitch, px_per_mm=1.0 if scaled else wanted.px_per_mm)
    return tuple(
        head.model_copy(
            update={
                "nominal_center_mm": head.nominal_center_mm if placed else (n * pitch, 0.0),
                "nominal_px_per_mm": head.nominal_px_per_mm or wanted.px_per_mm,
            }
        )
        for n, head in enumerate(heads)
    )


def nominal_values_missing(**values: object) -> InputError:
    """Return the refusal of an array whose distance or resolution, by its parameter's name, is None."""
    missing = [name for name, value in values.items() if value is None]
    return InputError(
        f"{' and '.join(missing)} must be given.",
        action="Give them, or nominal_center_mm and nominal_px_per_mm of the cameras in station.toml.",
        code="nominal-values-missing",
    )
