"""Seats for pictures and for files of whole boards: each is held until the caller has read its answer."""

from __future__ import annotations

from collections.abc import AsyncIterator

from fastapi import Request

from vaoi_station.api.callers.caller import caller_of
from vaoi_station.api.callers.seats import QueuedSeats, Seats

PICTURE_THREADS = 8
"""Number of pictures that are made at the same time."""
PICTURES_OF_CALLER = 6
"""Largest number of pictures of one caller that are being made or have not been read yet."""
PICTURES_WAITING = 24
PICTURE_WAIT_S = 20.0
FILES, FILES_OF_CALLER = 2, 1
"""Largest number of files of whole boards, in all and of one caller, that are being made or have not been read yet."""


class PictureSeats(QueuedSeats):
    """The seats for frames and temporary images. A seat is the right to one picture in memory."""

    def __init__(self) -> None:
        super().__init__("pictures", PICTURE_THREADS, PICTURES_OF_CALLER, PICTURES_WAITING, PICTURE_WAIT_S)

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its picture; a dependency of routes."""
        # A dependency ends after the reply was sent. So the memory for pictures that are not read is limited.
        async with self.take(caller_of(request).name):
            yield


class FileSeats(Seats):
    """The seats for files of whole boards. One takes a worker for minutes, and more than a gigabyte of the disk."""

    def __init__(self) -> None:
        super().__init__("files of whole boards that are made or read", FILES, FILES_OF_CALLER)

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its file; a dependency of routes."""
        with self.take(caller_of(request).name):
            yield
