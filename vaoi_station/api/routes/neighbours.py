"""Routes under `neighbours`: the machines beside the station, by messages and by contacts, and their boards."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import StateError
from vaoi_station.hermes.service import NO_LINE, LineStatus

_BOARD = "Id of a board of `boards`, or name of one of `contacts.boards`."


def router(services: Services) -> APIRouter:
    """Create the routes for the neighbours."""
    routes = rest_router(prefix="/neighbours", tags=["station"])
    ask = services.commands.ask

    async def status() -> LineStatus:
        stated = NO_LINE if services.line is None else services.line.status()
        contacts = await ask(services.coordinator.contacts)
        role = "contacts" if contacts is not None and stated.role == "none" else stated.role
        return stated.model_copy(update={"contacts": contacts, "role": role})

    @routes.get("")
    async def get_neighbours() -> LineStatus:
        """Return the neighbours in the line, the boards that wait for the next machine, and the latest messages.

        `contacts` has the contacts of IPC-SMEMA-9851, and the boards that are offered by them. `role` is `none`, and
        everything else empty, if station.toml has neither a table [hermes] nor [smema].
        """
        return await status()

    @routes.delete("/boards/{board_id:path}")
    async def remove_board(
        board_id: Annotated[
            str,
            Path(
                description="Id of a board of `boards`, or name of one of `contacts.boards`.",
                min_length=1,
                max_length=1000,
            ),
        ],
    ) -> LineStatus:
        """State that a board is out of the station: it was taken off behind the cameras, or the next machine has it.

        It is not offered to the next machine any more. 409: no such board waits, or it is on its way by the messages of
        the line. Contacts do not say what is on its way: a board that they offer is never refused, so do not state it
        while the board moves.
        """
        if (contacts := await ask(services.coordinator.contacts)) is not None and contacts.next_ready is not None:
            await ask(services.coordinator.take_board_out, board_id)
        elif services.line is None:
            raise StateError("The station has no neighbours.", action="Write [hermes] or [smema] (docs/line.md).")
        else:
            await ask(services.line.remove, board_id)
        return await status()

    return routes
