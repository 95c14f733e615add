"""Routes under `boards`: a board by its id, with the runs of both sides."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from vaoi_station.api.http_caching import LIVE, json_response
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.runs.board_sides import BoardDocument, Line, find_sides, join_sides

BoardId = Annotated[
    str, Path(description="Id of a board, as it was armed, read or reported.", min_length=1, max_length=200)
]


def router(services: Services) -> APIRouter:
    """Create the routes for boards."""
    routes = rest_router(prefix="/boards", tags=["runs"])
    coordinator, ask, search = services.coordinator, services.commands.ask, services.searching.ask

    @routes.get("/{board_id:path}", dependencies=[Depends(services.search_seats.hold)], response_model=BoardDocument)
    async def get_board(
        request: Request,
        board_id: BoardId,
        *,
        within: Annotated[float, Query(description="Longest time between the runs of both sides, s.", gt=0)] = 3600.0,
        parts: Annotated[bool, Query(description="Whether the parts of both sides are wanted.")] = False,
    ) -> Response:
        """Return a board with its newest runs of top and bottom, by the id that was armed, read or reported.

        A side that is missing, still comes, is not `ok`, states another id or does not fit the other is among the
        reasons. Only runs and orders of this station, and runs that were imported into it: in Python,
        `station.board(id, other)` joins two stations.
        """
        prefix = request.url.path.partition("/boards/")[0] + "/runs"

        def joined(line: Line) -> BoardDocument:
            found = find_sides(board_id, line, within, prefix)
            board = join_sides(board_id, found.sides, within, found.coming, found.with_parts)
            return board if parts else board.without_parts()

        orders = (await ask(coordinator.orders.list)).orders
        line = Line(coordinator.kept, coordinator.finished, coordinator.board_type, orders)
        return json_response(request, await search(joined, line), LIVE)

    return routes
