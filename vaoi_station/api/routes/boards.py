"""Routes under `boards`: a board by its id, with the runs of both sides."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response

from vaoi_station.api.http_caching import LIVE, json_response
from vaoi_station.api.limits import caller_of
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.model import Reason
from vaoi_station.runs.board_sides import BoardDocument, FoundSides, Line, find_sides, join_sides

BoardId = Annotated[
    str, Path(description="Id of a board, as it was armed, read or reported.", min_length=1, max_length=200)
]


def router(services: Services) -> APIRouter:
    """Create the routes for boards."""
    routes = rest_router(prefix="/boards", tags=["runs"])
    coordinator, ask, search = services.coordinator, services.commands.ask, services.searching.ask

    @routes.get("/{board_id:path}", response_model=BoardDocument)
    async def get_board(
        request: Request,
        board_id: BoardId,
        *,
        within: Annotated[float, Query(description="Longest time between the runs of both sides, s.", gt=0)] = 3600.0,
        parts: Annotated[bool, Query(description="Whether the parts of both sides are wanted.")] = False,
        alone: Annotated[bool, Query(description="Whether `other_station` of station.toml is left out.")] = False,
    ) -> Response:
        """Return a board with its newest runs of top and bottom, by the id that was armed, read or reported.

        A side that is missing, still comes, is not `ok`, states another id or does not fit the other is among the
        reasons. Runs and orders are those of this station, runs that were imported into it, and those of the station
        that `other_station` of station.toml names. In Python, `station.board(id, other)` joins any stations.
        """
        prefix = request.url.path.partition("/boards/")[0] + "/runs"
        other, elsewhere, silent = services.other_station, None, list[Reason]()
        if other is not None and not alone:
            try:
                elsewhere = await services.elsewhere.listen(other.board, board_id, within)
            except DeviceError as error:
                # Even with both sides here: a newer run of one may be there.
                silent = [Reason(code="other-station-silent", message=error.message, action=error.action)]

        def joined(line: Line) -> BoardDocument:
            try:
                found = find_sides(board_id, line, within, prefix)
            except NotFoundError:
                if elsewhere is None:
                    raise
                found = FoundSides([], {}, ())
            sides, coming = found.sides, found.coming
            if elsewhere is not None:
                sides, coming = [*sides, *elsewhere.every_side], (*coming, *elsewhere.coming)
            board = join_sides(board_id, sides, within, coming, found.with_parts, among=found.among, more=silent)
            return board if parts else board.without_parts()

        orders = (await ask(coordinator.orders.list)).orders
        line = Line(coordinator.kept, coordinator.finished, coordinator.board_type, orders)
        # Not held while the other station is asked, which asks this one: both would wait for seats of each other.
        async with services.search_seats.take(caller_of(request).name):
            return json_response(request, await search(joined, line), LIVE)

    return routes
