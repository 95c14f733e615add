"""Request models about light programs; the answers are in `runs.lighting`."""

from __future__ import annotations

from pydantic import Field

from vaoi_station.model import Strict
from vaoi_station.model.light_program import Program


class ProgramRequest(Strict):
    """A light program that is to be checked."""

    program: Program | None = Field(
        default=None,
        description="The steps, as in a board type; empty: those of the station; absent: those in force.",
    )
