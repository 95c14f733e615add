"""Routes under `cameras` and `doctor`: the newest frame of each camera with its figures; the findings of the doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from vaoi_station.api.cameras.examination import Examination, Examinations
from vaoi_station.api.cameras.frames import (
    CameraFrame,
    CameraTrialFrame,
    CameraTrialRequest,
    CameraTrials,
    NewestFrames,
)
from vaoi_station.api.limits import Seats, ThreadLimit, caller_of
from vaoi_station.api.parameters import Camera, file_reply, rest_router
from vaoi_station.api.routes.services import Services

EXAMINATIONS, EXAMINATIONS_OF_CALLER = 32, 8
"""Limits of requests that wait for an examination, in total and of one caller."""
JPEG = file_reply("The picture.", "image/jpeg")


def router(services: Services, trials: CameraTrials, config: Path | None = None) -> APIRouter:
    """Create the routes for cameras; `config` is the station.toml that the doctor examines."""
    routes = rest_router(tags=["station"])
    frames, examinations = NewestFrames(services.coordinator), Examinations(config, services.hub.closing)
    # One pulse at a time; a caller that comes meanwhile waits for a moment.
    shooting = ThreadLimit(1)
    seats = Seats("requests for an examination that wait", EXAMINATIONS, EXAMINATIONS_OF_CALLER)

    # Measuring a frame takes a thread of pictures, so that it takes a seat for pictures as well.
    @routes.get(
        "/cameras/{camera}/frame",
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_camera_frame(camera: Camera) -> CameraFrame:
        """Return the figures of a camera's newest frame in memory: sharpness over the field, histogram, exposure.

        404 `no-frame-yet`: no frame of the camera is in memory. State, temperature, packets: `cameras` of GET station.
        """
        return await services.pictures.ask(frames.frame, camera)

    @routes.get(
        "/cameras/{camera}/picture",
        response_class=Response,
        responses=JPEG,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_camera_picture(
        camera: Camera,
        run: Annotated[str | None, Query(description="Run of the frame.", min_length=1, max_length=64)] = None,
        row: Annotated[int | None, Query(description="Row of the frame.", ge=0, le=99999)] = None,
    ) -> Response:
        """Return a frame as JPEG of at most 960 px, for display; without `run` and `row` the newest in memory.

        Without loss, and in full size: `runs/{run}/frames/{camera}/{row}`.
        """
        content = await services.pictures.ask(frames.picture, camera, run, row)
        return Response(content, media_type="image/jpeg")

    @routes.post("/cameras/{camera}/trial")
    async def try_camera_settings(camera: Camera, body: CameraTrialRequest) -> CameraTrialFrame:
        """Fire one pulse with settings on trial while the line is disarmed; return the figures of the camera's frame.

        Nothing is changed for good: arming ends the trial, and 10 s after the last pulse the settings of station.toml
        are set again. 409 `line-armed`: the line is armed; 409 `trial-running`: another pulse is under way.
        """
        return await shooting.ask(trials.shoot, camera, body)

    @routes.delete("/cameras/{camera}/trial", status_code=204)
    async def end_camera_trial(camera: Camera) -> None:  # noqa: ARG001  a trial has one camera at a time
        """Set the settings of station.toml again, now."""
        await services.commands.ask(trials.end)

    @routes.get(
        "/cameras/{camera}/trial/picture",
        response_class=Response,
        responses=JPEG,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_camera_trial_picture(
        camera: Camera,
        number: Annotated[int | None, Query(description="Number of the trial [the newest].", ge=1, le=10**9)] = None,
    ) -> Response:
        """Return the newest frame of a trial as JPEG of at most 960 px. 404 `no-trial-frame`: there is none."""
        content = await services.pictures.ask(trials.picture, camera, number)
        return Response(content, media_type="image/jpeg")

    @routes.get("/doctor")
    async def examine_station(request: Request) -> Examination:
        """Run `vaoi doctor` on the station's machine and return its findings; it changes nothing and takes seconds.

        An answer or failure of the last 10 s is given again. 404 `not-examinable`: the station has no station.toml.
        """
        with seats.take(caller_of(request).name):
            return await examinations.examine()

    return routes
