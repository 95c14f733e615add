"""Routes under `calibration/trial` and `calibration/artwork`: calibrate the array from a run of the station."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from vaoi_station.api.cameras.trials import CameraTrials
from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.design import nominal_values_missing
from vaoi_station.api.setup.found_marks import FoundMarks, MarksRequest, find_marks
from vaoi_station.api.setup.models import ArtworkOptions, CalibrationTrial, TrialRequest
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.api.setup.trials import Trials
from vaoi_station.calibration.artwork import ArrayDesign, Board, design_board
from vaoi_station.calibration.artwork.artwork_files import RENDERERS, array_of, artwork_title
from vaoi_station.files.layouts import Layout

ArtworkFile = Literal[
    "calibration-board.svg", "calibration-board.pdf", "calibration-board.gbr", "calibration-board-outline.gbr"
]
_MEDIA = {"svg": "image/svg+xml", "pdf": "application/pdf", "gbr": "application/octet-stream"}
_SVG_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox"
FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The file.",
        "content": {media: {"schema": {"type": "string", "format": "binary"}} for media in _MEDIA.values()},
    }
}
DOCUMENT: dict[int | str, dict[str, Any]] = {
    200: {"description": "The calibration.", "content": {"application/json": {"schema": {"type": "object"}}}}
}
JPEG: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture.", "content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}}
}
Options = Annotated[ArtworkOptions, Query()]


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

    @routes.get("/artwork/{file}", response_class=Response, responses=FILES)
    async def get_calibration_artwork(file: ArtworkFile, options: Options) -> Response:
        """Return a file of the artwork of a calibration board for the cameras of this station, to print at 1:1.

        Vector graphics for printers have the number of each camera and an arrow along them.
        """
        content = await ask(lambda: RENDERERS[file](*board(options)))
        headers = {"Cache-Control": LIVE, "Content-Security-Policy": _SVG_POLICY}
        return Response(content, media_type=_MEDIA[file.rpartition(".")[2]], headers=headers)

    @routes.get("/layout", response_model=Layout)
    async def get_calibration_layout(options: Options) -> Response:
        """Return the places of the marks of the artwork that the same parameters give: its `layout.json`."""
        layout = (await ask(board, options))[0].layout
        text = layout.model_dump_json(exclude_none=True)
        return Response(text, media_type="application/json", headers={"Cache-Control": LIVE})

    @routes.post("/marks")
    async def find_calibration_marks(response: Response, wanted: MarksRequest) -> FoundMarks:
        """Search one frame for the marks of a calibration board: whether the camera shows what it should.

        It is a frame of a run, or while the board is being laid one of `cameras/{camera}/trial`.
        One frame at a time is searched, so that boards are not held up.
        """
        response.headers["Cache-Control"] = LIVE
        return await searching.ask(find_marks, services.coordinator, camera_trials, files, wanted)

    @routes.get("/trial", response_model_exclude_none=True)
    async def get_calibration_trial(response: Response) -> CalibrationTrial:
        """Return the latest trial of a calibration: how far it is, or what it has found."""
        response.headers["Cache-Control"] = LIVE
        return await ask(trials.status)

    @routes.post("/trial", status_code=202, response_model_exclude_none=True)
    async def begin_calibration_trial(response: Response, wanted: TrialRequest) -> CalibrationTrial:
        """Calibrate the array from one row of a run that shows the calibration board, and reply at once.

        `GET calibration/trial` states how far it is. Nothing is changed until it is accepted. 409 `line-armed`: the
        line is armed; 409 `trial-running`: another trial is being made.
        """
        response.headers["Cache-Control"] = LIVE
        begun = await ask(trials.begin, wanted)
        task = asyncio.create_task(making.ask(trials.perform, wanted))
        # The event loop keeps only weak references to tasks.
        under_way.add(task)
        task.add_done_callback(under_way.discard)
        return begun

    @routes.delete("/trial", response_model_exclude_none=True)
    async def discard_calibration_trial(response: Response) -> CalibrationTrial:
        """Discard the latest trial, which cannot be accepted afterwards; what was accepted before stays.

        409 `trial-running`: one is being made, or accepted by another caller.
        """
        response.headers["Cache-Control"] = LIVE
        return await ask(trials.discard)

    @routes.post("/trial/accept", response_model_exclude_none=True)
    async def accept_calibration_trial(response: Response) -> CalibrationTrial:
        """Replace the calibration file of the station by that of the trial; a copy of the one before is kept.

        It is in force from the next start of the station on. 409 `no-trial`: no trial has ended well; 409
        `trial-running`: one is being made, or accepted by another caller; 409 `settings-read-only`: the service may
        not write the file.
        """
        response.headers["Cache-Control"] = LIVE
        return await ask(trials.accept)

    @routes.get("/trial/calibration", response_class=Response, responses=DOCUMENT)
    async def get_trial_calibration() -> Response:
        """Return the calibration of the trial as a file, in the format of `docs/formats.md`."""
        return Response(await ask(trials.document), media_type="application/json", headers={"Cache-Control": LIVE})

    @routes.get("/trial/pictures/{picture}", response_class=Response, responses=JPEG)
    async def get_trial_picture(picture: Literal["marks", "difference"]) -> Response:
        """Return a picture of the trial: the marks that were found, or the difference to the calibration in force."""
        return Response(await ask(trials.picture, picture), media_type="image/jpeg", headers={"Cache-Control": LIVE})

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
