"""Routes under `station` and `calibration`: return its state, arm it, disarm it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Depends, Path, Query

from vaoi_station.api.limits import Seats, ThreadLimit
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.rest_models import ArmRequest, CallerId, PlainText
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.schemas import CalibrationStatus, StationSnapshot

ARMING, ARMING_OF_CALLER = 8, 4
"""Limits of requests to arm at a time, in total and of one caller: they may wait for a board that passes."""
TypeName = Annotated[str | None, Query(max_length=200)]
BoardId = Annotated[CallerId | None, Query(min_length=1, max_length=200)]
JobId = Annotated[PlainText | None, Query(min_length=1, max_length=200)]


def router(services: Services) -> APIRouter:
    """Create the routes for the station."""
    routes = rest_router(prefix="/station", tags=["station"])
    coordinator, ask = services.coordinator, services.commands.ask
    # Requests that wait must not take the threads that disarming needs, also when their callers have gone.
    arming, arms = ThreadLimit(ARMING), Seats("requests to arm that wait", ARMING, ARMING_OF_CALLER)

    @routes.get("")
    async def get_station() -> StationSnapshot:
        """Return the station's state, health, memory, versions and retention."""
        return await ask(coordinator.snapshot)

    @routes.post("/arm", dependencies=[Depends(arms.hold)])
    async def arm_station(
        *,
        request: Annotated[ArmRequest, Body(default_factory=ArmRequest)],
        board_type: TypeName = None,
        board_id: BoardId = None,
        job_id: JobId = None,
        runs: Annotated[int | None, Query(ge=1, le=1_000_000)] = None,
        orders: bool | None = None,
        allow_lost_cameras: bool | None = None,
        passing: Passing | None = None,
    ) -> StationSnapshot:
        """Arm the station: film every board from now on. The order is given as JSON body, query parameters, or both.

        Replies when the order is in force. While a board passes, which keeps the order before, this waits until it has
        left; with `passing=after` it replies at once (`next_order`), with `passing=refuse` 409. Orders that wait
        (`orders`) come first, and with `orders=true` only they. 404: unknown board type; 409: the station is faulted;
        503: a camera is lost (code `camera-lost`; `allow_lost_cameras` arms without it), or all memory is in use (the
        detail names the holders).
        """
        given = {
            "board_type": board_type,
            "board_id": board_id,
            "job_id": job_id,
            "runs": runs,
            "orders": orders,
            "allow_lost_cameras": allow_lost_cameras,
            "passing": passing,
        }
        order = _merged(request, given)
        despite, passing = bool(order.allow_lost_cameras), order.passing or "wait"
        wanted = order.board_type, order.board_id, order.job_id, order.runs, despite, passing
        return await arming.ask(coordinator.arm, *wanted)

    @routes.post("/disarm")
    async def disarm_station() -> StationSnapshot:
        """Disarm the station: ignore the light barrier. A run under way is still finished. No effect when idle."""
        return await ask(coordinator.disarm)

    @routes.post("/set-aside/{file}/acknowledge")
    async def acknowledge_database(
        file: Annotated[str, Path(description="Name of a file of `set_aside`.", max_length=200)],
    ) -> StationSnapshot:
        """End the warning about a database that was set aside, also for later starts; the file stays.

        Needs the scope admin. 404: no such file was set aside.
        """
        await ask(coordinator.storage.acknowledge, file)
        return await ask(coordinator.snapshot)

    calibration = rest_router(prefix="/calibration", tags=["station"])

    @calibration.get("")
    async def get_calibration() -> CalibrationStatus:
        """Return the calibration in use, and for each camera its state, its drift (size and start) and its history.

        A displacement is the camera's motion since its calibration, in px of its frame, estimated from filmed boards.
        """
        return await ask(coordinator.calibration)

    routes.routes += calibration.routes
    return routes


def _merged(request: ArmRequest, given: dict[str, Any]) -> ArmRequest:
    """Merge JSON body and query parameters; raise InputError if they contradict each other or name no board type."""
    merged = request.model_dump()
    for key, value in given.items():
        if value is not None and merged[key] not in (None, value):
            raise InputError(
                f"{key} is {merged[key]!r} in the body and {value!r} in the query.", action="Give the value once."
            )
        merged[key] = merged[key] if value is None else value
    of_type = ("board_type", "board_id", "job_id", "runs", "allow_lost_cameras")
    given_too = [key for key in of_type if merged[key] not in (None, False)]
    if merged["orders"] and given_too:
        raise InputError(f"orders excludes {', '.join(given_too)}.", action="Give orders alone, or a board type.")
    if not merged["orders"] and not merged["board_type"]:
        raise InputError(
            "board_type is missing; it must name a stored board type.",
            action="Choose a board type from /api/v1/board-types.",
        )
    return ArmRequest.model_validate(merged)
