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
