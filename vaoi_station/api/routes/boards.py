"""Routes under `boards`: a board by its id, with the runs of both sides."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request

from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.runs.board_sides import BoardDocument, join_sides, sides_of

BoardId = Annotated[
    str, Path(description="Id of a board, as it was armed, read or reported.", min_length=1, max_length=200)
]


def router(services: Services) -> APIRouter:
    """Create the routes for boards."""
    routes = rest_router(prefix="/boards", tags=["runs"])
    coordinator, search = services.coordinator, services.searching.ask

    @routes.get("/{board_id:path}", dependencies=[Depends(services.search_seats.hold)])
    async def get_board(
        request: Request,
        board_id: BoardId,
        within: Annotated[float, Query(description="Longest time between the runs of both sides, s.", gt=0)] = 3600.0,
    ) -> BoardDocument:
        """Return a board with its newest runs of top and bottom, by the id that was armed, read or reported.

        A side that is missing, is not `ok`, states another id or does not fit the other is among the reasons. Only runs
        of this station, and those that were imported into it: in Python, `station.board(id, other)` joins two stations.
        """
        prefix = request.url.path.partition("/boards/")[0] + "/runs"
        sides = await search(sides_of, board_id, coordinator.kept, coordinator.finished, prefix)
        return join_sides(board_id, sides, within)

    return routes
