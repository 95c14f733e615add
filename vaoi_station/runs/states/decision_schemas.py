"""Schemas of what a person has decided about a run whose pictures are not good, and of the counts of runs."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

Choice = Literal["film-again", "use"]
"""`film-again`: film the board again, do not use these pictures. `use`: use them in spite of the verdict."""


class Decision(BaseModel):
    """What a person has decided about a run, with name and reason. The verdict stays as it is."""

    model_config = ConfigDict(frozen=True, extra="forbid", cache_strings="keys")

    choice: Choice
    name: str
    """Name of the person."""
    reason: str
    decided: str
    """Time of the decision, RFC 3339 in UTC."""


class RunCounts(BaseModel):
    """Numbers of boards since a time, by verdict."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    since: str
    """RFC 3339 in UTC."""
    ok: int
    degraded: int
    failed: int
    """Runs with the verdict failed, and runs that ended without a result."""
    missed: int
    """Boards that passed without a run, and were noticed."""
    complete: bool = True
    """False: since then more than 20,000 boards have come, of which the newest are counted."""
