"""What an archive reads of run.json, the record of a station."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel

from vaoi_station.config import MethodName
from vaoi_station.errors import InputError
from vaoi_station.files.documents import parse, read_json
from vaoi_station.model import Status
from vaoi_station.stitching.expectation import StitchTerms

RUN_FILE = "run.json"


class _Identity(BaseModel):
    """What an archive needs of the identity of a board."""

    state: str
    board_id: str | None = None


class RecordedReason(BaseModel):
    """A reason of a run."""

    code: str
    message: str


class MadeWith(BaseModel):
    """With what a station stitched a run."""

    method: MethodName
    reference: str | None = None
    """Id of the run against which the board was placed; None: without a reference."""
    terms: StitchTerms | None = None
    """None: of an earlier version, which did not state them."""


class StationRecord(BaseModel):
    """What an archive needs of run.json."""

    id: str
    started: str
    board_id: str | None = None
    verdict: Status | None = None
    identity: _Identity | None = None
    reasons: tuple[RecordedReason, ...] = ()
    made_with: MadeWith | None = None

    @property
    def serial(self) -> str | None:
        """Id of the board: that of its code, or that with which the line was armed."""
        return (self.identity.board_id if self.identity else None) or self.board_id


def read_record(folder: Path) -> StationRecord | None:
    """Read the record in a recording; None if no station filmed it.

    Raises:
        InputError: it is invalid, or the codes of the board were still to be read, which may lower the verdict.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        return None
    record = parse(StationRecord, read_json(path), path)
    if record.identity is not None and record.identity.state == "pending":
        raise InputError(
            f"{path}: identity.state is 'pending': the verdict is not final until the codes of the board are read.",
            action="Add the run when its station has read them; copy the recording again if this is a copy.",
        )
    return record
