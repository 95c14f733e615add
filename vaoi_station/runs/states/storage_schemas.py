"""Documents about databases that were set aside, for callers."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class SetAsideFile(BaseModel):
    """A damaged, deleted or replaced database, of which a file was set aside beside the present one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: str
    """Name of the file in the data directory."""
    code: str
    """Code of the warning about it."""
    acknowledged: bool
    """Whether an administrator has acknowledged it, so that the station no longer warns."""


class ArchiveStatus(BaseModel):
    """The archive to which the station hands finished runs (`[archive]` of station.toml)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    waiting: int
    """Number of runs that wait for it on the station's disk."""
    adding: str | None
    """Id of the run that is being added; None if none is."""
    added: int
    """Number of runs since the start that are in the archive."""
    dropped: int
    """Number of runs since the start whose recordings were deleted before the archive took them."""
    refused: int
    """Number of runs since the start that could not be added for a reason of their own."""
    problem: str
    """Why the archive takes no runs at present; empty if it does."""
