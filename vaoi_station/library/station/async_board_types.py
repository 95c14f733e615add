"""The board types of a running station for programs with asyncio: the calls of `station_board_types` in threads."""

from __future__ import annotations

import asyncio

from vaoi_station.config import MethodName
from vaoi_station.library.station.station_board_types import StationBoardTypes
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion
from vaoi_station.runs.states.schemas import BoardTypeSummary
from vaoi_station.runs.states.stitching_schemas import ReferenceStatus, StitchingMethod


class AsyncBoardTypes:
    """The board types of a station; every method is that of `StationBoardTypes`, where it is described."""

    def __init__(self, board_types: StationBoardTypes) -> None:
        self._board_types = board_types

    async def list(self) -> tuple[BoardTypeSummary, ...]:
        """Return a summary of each board type, sorted by name; `fault` says why a file cannot be used."""
        return await asyncio.to_thread(self._board_types.list)

    async def deleted(self) -> tuple[str, ...]:
        """Return the names of deleted board types, of which a version can be restored."""
        return await asyncio.to_thread(self._board_types.deleted)

    async def get(self, name: str) -> BoardType:
        """Return a board type."""
        return await asyncio.to_thread(self._board_types.get, name)

    async def get_tagged(self, name: str) -> tuple[BoardType, str]:
        """Return a board type, and the tag of this version."""
        return await asyncio.to_thread(self._board_types.get_tagged, name)

    async def put(self, board_type: BoardType, *, tag: str | None = None, new: bool = False) -> BoardType:
        """Store a board type, or replace it; the version before can be restored. Return what was stored."""
        return await asyncio.to_thread(self._board_types.put, board_type, tag=tag, new=new)

    async def delete(self, name: str, *, tag: str | None = None) -> None:
        """Delete a board type, of which a version is kept; refused while the line is armed with it."""
        await asyncio.to_thread(self._board_types.delete, name, tag=tag)

    async def set_state(self, name: str, state: BoardTypeState, revision: str | None = None) -> BoardType:
        """Set the state `draft`, `approved` or `retired`, and the revision of the data if it is given."""
        return await asyncio.to_thread(self._board_types.set_state, name, state, revision)

    async def versions(self, name: str) -> tuple[BoardTypeVersion, ...]:
        """Return the versions that were replaced or deleted, newest first."""
        return await asyncio.to_thread(self._board_types.versions, name)

    async def version(self, name: str, version: str) -> BoardType:
        """Return the document of a version; `latest` is the one before the present."""
        return await asyncio.to_thread(self._board_types.version, name, version)

    async def restore(self, name: str, version: str = "latest") -> BoardType:
        """Put a version in force again; the present one becomes a version itself."""
        return await asyncio.to_thread(self._board_types.restore, name, version)

    async def reference(self, name: str) -> ReferenceStatus | None:
        """Return the run against which boards of the type are placed; None if there is none."""
        return await asyncio.to_thread(self._board_types.reference, name)

    async def teach(self, name: str, run: str, *, confirm_orientation: bool = False) -> ReferenceStatus:
        """Make a finished run the reference of its board type."""
        return await asyncio.to_thread(self._board_types.teach, name, run, confirm_orientation=confirm_orientation)

    async def forget_reference(self, name: str) -> None:
        """Delete the reference of a board type."""
        await asyncio.to_thread(self._board_types.forget_reference, name)

    async def method(self, name: str) -> StitchingMethod:
        """Return the stitching method of a board type, and whether it was set for it."""
        return await asyncio.to_thread(self._board_types.method, name)

    async def set_method(self, name: str, method: MethodName) -> StitchingMethod:
        """Set the stitching method of a board type."""
        return await asyncio.to_thread(self._board_types.set_method, name, method)

    async def forget_method(self, name: str) -> StitchingMethod:
        """Delete the method that was set for a board type; return the station's, which applies then."""
        return await asyncio.to_thread(self._board_types.forget_method, name)
