"""Routes under `neighbours`: the machines beside the station that speak IPC-HERMES-9852, and their boards."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import StateError
from vaoi_station.hermes.service import NO_LINE, LineStatus


def router(services: Services) -> APIRouter:
    """Create the routes for the neighbours."""
    routes = rest_router(prefix="/neighbours", tags=["station"])
    ask = services.commands.ask

    @routes.get("")
    async def get_neighbours() -> LineStatus:
        """Return the neighbours in the line, the boards that wait for the next machine, and the latest messages.

        `role` is `none`, and everything else empty, if station.toml has no table [hermes].
        """
        return NO_LINE if services.line is None else services.line.status()

    @routes.delete("/boards/{board_id:path}")
    async def remove_board(
        board_id: Annotated[str, Path(description="Id of a board of `boards`.", min_length=1, max_length=1000)],
    ) -> LineStatus:
        """State that a board is out of the station: it was taken off behind the cameras, or the next machine has it.

        It is not offered to the next machine any more. 409: no such board waits, or it is on its way.
        """
        if services.line is None:
            raise StateError("The station has no neighbours.", action="Write the table [hermes] (docs/line.md).")
        return await ask(services.line.remove, board_id)

    return routes
