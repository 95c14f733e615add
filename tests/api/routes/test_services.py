"""The pools of threads in which routes call the coordinator: a full pool of pictures holds up no command."""

from __future__ import annotations

import threading
from typing import Any

import anyio

from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.routes.services import PICTURE_THREADS, Services


def test_busy_pictures_hold_up_no_command(station: Any) -> None:
    """Rendering fills its pool. A command runs in another one, and so does the next picture once a thread is free."""
    services, free, done = Services(station, EventHub(station)), threading.Event(), []

    async def picture() -> None:
        await services.pictures.ask(free.wait, 10.0)
        done.append("picture")

    async def command() -> None:
        await services.commands.ask(lambda: done.append("command"))
        free.set()

    async def all_together() -> None:
        async with anyio.create_task_group() as tasks:
            for _ in range(PICTURE_THREADS + 1):
                tasks.start_soon(picture)
            tasks.start_soon(command)

    anyio.run(all_together)
    assert done[0] == "command"
    assert done.count("picture") == PICTURE_THREADS + 1
