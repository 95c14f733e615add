"""Routes of the check of a board type against a run, and of its correction."""

from __future__ import annotations

import json
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request, Response

from vaoi_station.api.http_caching import LIVE, REVALIDATE, conditional_response, require_unchanged
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import BoardTypeName, IfMatch, RunId, rest_router
from vaoi_station.api.rest_models import CorrectionRequest
from vaoi_station.api.routes.services import Services
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.model import BoardType

Checked = Annotated[
    str | None,
    Query(description="Name of the board type that is checked [that of the run].", min_length=1, max_length=200),
]
JPEG: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture.", "content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}}
}


def router(services: Services) -> APIRouter:
    """Create the routes."""
    routes = rest_router(tags=["board types"])
    coordinator, checks = services.coordinator, services.coordinator.mosaics.board_checks
    # A check takes a worker for seconds: one caller at a time, and none of the threads for pictures.
    checking = ThreadLimit(1)

    def stored(run: str, name: str | None) -> BoardType:
        return coordinator.board_type(name or checks.own_type(run))

    @routes.get("/runs/{run}/board-check", response_model=BoardCheck)
    async def check_board_type(request: Request, run: RunId, board_type: Checked = None) -> Response:
        """Lay a board type, as it is stored now, over a run: shift, rotation, mirror and scale of its components.

        The reply names components that do not look as if they were there, and proposes a corrected board type. It
        takes some seconds. 410: the frames are no longer in memory.
        """
        found = await checking.ask(lambda: checks.check(run, stored(run, board_type)))
        body = found.report.model_dump_json(exclude_none=True).encode()
        return conditional_response(request, body, "application/json", cache=REVALIDATE)

    @routes.get(
        "/runs/{run}/board-check/picture",
        response_class=Response,
        responses=JPEG,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_board_check_picture(request: Request, run: RunId, board_type: Checked = None) -> Response:
        """Return the picture of the check: bodies where the run's C puts them (blue) and where they are (yellow).

        Components that do not look as if they were there are red.
        """
        found = await checking.ask(lambda: checks.check(run, stored(run, board_type)))
        return conditional_response(request, found.picture, "image/jpeg", cache=REVALIDATE)

    @routes.post("/board-types/{name}/correct", response_model=BoardType)
    async def correct_board_type(
        request: Request, name: BoardTypeName, body: CorrectionRequest, _: IfMatch = None
    ) -> Response:
        """Store the correction that the check against a run proposes, as a draft. The version before can be restored.

        409 `nothing-to-correct`: the check proposes none.
        """
        # The check takes seconds, so other changes do not wait for it. One that comes meanwhile is checked again.
        stored = False
        while not stored:
            before = await services.commands.ask(coordinator.board_type, name)
            require_unchanged(request, _document(before), f"Board type {name!r}")
            corrected = await checking.ask(checks.correct, body.run, before, body.revision)
            async with services.changing:
                stored = await services.commands.ask(coordinator.board_type, name) == before
                if stored:
                    await services.commands.ask(coordinator.put_board_type, corrected)
        headers = {"Cache-Control": LIVE, "Content-Location": quote(request.url.path.rpartition("/")[0])}
        return Response(_document(corrected), media_type="application/json", headers=headers)

    return routes


def _document(board_type: BoardType) -> bytes:
    return json.dumps(board_type.model_dump(exclude_none=True), allow_nan=False).encode()
