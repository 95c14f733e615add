"""The REST service under `/api/v1` and the operator's page, over the methods of `StationCoordinator`."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal

from fastapi import Depends, FastAPI, Response

from vaoi_station.api import batch, openapi, pages, problems
from vaoi_station.api.access import AccessControl
from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.middleware import guards
from vaoi_station.api.other_station import OtherStation
from vaoi_station.api.parameters import operation_id, refuse_unclear_parameters
from vaoi_station.api.rest_models import Health
from vaoi_station.api.routes import (
    board_data,
    board_types,
    boards,
    cameras,
    doctor,
    events,
    keys,
    metrics,
    mosaics,
    neighbours,
    orders,
    pictures,
    runs,
    station,
    trends,
)
from vaoi_station.api.routes.board_data import Previews
from vaoi_station.api.routes.cameras import CameraTrials
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup import calibration, camera_exchange, optics, settings
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.hermes.service import HermesService
from vaoi_station.push.publisher import Publisher
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.control.readiness import EXPECTED, NOT_READY
from vaoi_station.runs.states.schemas import StationSnapshot
from vaoi_station.runs.states.tables import StationState
from vaoi_station.version import __version__

NOT_OPERATIONAL = frozenset({StationState.STARTING, StationState.FAULTED, StationState.STOPPING})


def create_app(
    coordinator: StationCoordinator,
    names: Iterable[str] = (),
    access: AccessControl | None = None,
    publishers: tuple[Publisher, ...] = (),
    config: Path | None = None,
    files: StationFiles | None = None,
    root_path: str = "",
    line: HermesService | None = None,
) -> FastAPI:
    """Create the web application of a coordinator. The caller starts and stops the coordinator itself.

    Clients may address the application by any of `names`, by loopback, by the machine's names and by any IP address.
    Without `access`, every caller may send every request, and there are no keys; without `config`, the station's
    station.toml, no findings of the doctor; without `files`, nothing to set the station up; without `line`, no
    neighbours. Paths may begin with `root_path`, which a proxy has not removed.

    `app.state.hub.close()` ends streams and long polls, so that a server can stop without waiting for them. An event
    of kind "station" with state "stopping" has the same effect.
    """
    other = None if files is None else OtherStation.of(files.config.api)
    services = Services(coordinator, EventHub(coordinator), publishers, line, other)

    previews = Previews()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with services.hub.listening():
            try:
                yield
            finally:
                previews.close()

    # Redirects of trailing slashes would answer POST with a 307 that simple HTTP libraries do not follow.
    # One schema for input and output: with two, client generators would create two classes for each model.
    app = FastAPI(
        title="VAOI station",
        version=__version__,
        lifespan=lifespan,
        openapi_url=None,  # `openapi.install` adds the route
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        separate_input_output_schemas=False,
        generate_unique_id_function=operation_id,
        dependencies=[Depends(refuse_unclear_parameters)],
        middleware=guards(names, access, root_path),
    )
    app.state.hub = services.hub
    problems.install(app)
    # First, because routes are tried in order, and a browser asks for dozens of files of a page at once.
    pages.install(app)
    nouns = (station, orders, neighbours, board_types, boards, runs, trends, pictures, batch, mosaics, events)
    routers = [noun.router(services) for noun in nouns]
    camera_trials = CameraTrials(services.coordinator)
    routers += [
        cameras.router(services, camera_trials),
        doctor.router(services, config),
        board_data.router(services, previews),
    ]
    if access is not None:
        routers.append(keys.router(services, access))
    if files is not None:
        routers.append(calibration.router(services, files, camera_trials))
        routers += [setup.router(services, files) for setup in (camera_exchange, optics, settings)]
    for router in routers:
        app.router.routes.extend(router.routes)
    _add_health(app, services)
    app.router.routes.extend(metrics.router(services).routes)
    openapi.install(app)
    return app


def _add_health(app: FastAPI, services: Services) -> None:
    @app.get("/healthz", tags=["station"])
    async def get_health(response: Response) -> Health:
        """Return 200 if the station can film, else 503. Process supervisors use this address."""
        response.headers["Cache-Control"] = "no-store"
        if services.coordinator.faults():
            # This is read without the coordinator, because its thread may be the one that hangs.
            response.status_code = 503
            return Health(status="degraded", state=StationState.FAULTED, version=__version__)
        return _health(response, await services.commands.ask(services.coordinator.snapshot), ready_only=False)

    @app.get("/readyz", tags=["station"])
    async def get_readiness(response: Response) -> Health:
        """Return 200 if a board that came now would be filmed by all cameras and its result kept on disk, else 503.

        A station that is idle is ready, because it can be armed: `state` says whether it is. The codes say what is
        missing.
        """
        return _health(response, await services.commands.ask(services.coordinator.snapshot), ready_only=True)


def _health(response: Response, snapshot: StationSnapshot, *, ready_only: bool) -> Health:
    codes = list(dict.fromkeys(reason.code for reason in (*snapshot.reasons, *snapshot.warnings)))
    dead = snapshot.state in NOT_OPERATIONAL
    held = {reason.code for reason in snapshot.line_held} - EXPECTED
    unready = dead or bool(held) or snapshot.state is StationState.BLOCKED or not NOT_READY.isdisjoint(codes)
    response.status_code = 503 if dead or (ready_only and unready) else 200
    response.headers["Cache-Control"] = "no-store"
    status: Literal["ok", "degraded"] = "degraded" if unready else "ok"
    return Health(status=status, state=snapshot.state, version=__version__, codes=codes)
