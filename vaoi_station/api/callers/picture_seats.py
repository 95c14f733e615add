"""Seats for pictures: each is held until the caller has read its picture."""

from __future__ import annotations

from collections.abc import AsyncIterator

from fastapi import Request

from vaoi_station.api.callers.caller import caller_of
from vaoi_station.api.callers.seats import QueuedSeats

PICTURE_THREADS = 8
"""Number of pictures that are made at the same time."""
PICTURES_OF_CALLER = 6
"""Largest number of pictures of one caller that are being made or have not been read yet."""
PICTURES_WAITING = 24
PICTURE_WAIT_S = 20.0


class PictureSeats(QueuedSeats):
    """The seats for frames and temporary images. A seat is the right to one picture in memory."""

    def __init__(self) -> None:
        super().__init__("pictures", PICTURE_THREADS, PICTURES_OF_CALLER, PICTURES_WAITING, PICTURE_WAIT_S)

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its picture; a dependency of routes."""
        # A dependency ends after the reply was sent. So the memory for pictures that are not read is limited.
        async with self.take(caller_of(request).name):
            yield
