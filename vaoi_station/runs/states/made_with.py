"""What a run was made with: documents by their digests, the state of the clock, and the station of an imported run."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from vaoi_station.config import MethodName
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.stitching.expectation import StitchTerms


class MadeWith(BaseModel):
    """What a run was made with besides software and calibration. Digests are 16 hex digits of a SHA-256."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    configuration: str
    """Digest of the station's configuration; empty if it was not stored."""
    board_type: str
    """Digest of the board type as it was when the line was armed."""
    board_type_revision: str | None = None
    """The revision that the board type stated."""
    board_type_state: BoardTypeState | None = None
    method: MethodName
    reference: str | None = None
    """Id of the run against which the board was placed; None: without a reference."""
    reference_digest: str | None = None
    """Digest of the files of the reference."""
    terms: StitchTerms | None = None
    """What the station knew of line and lights; None for runs of earlier versions."""
    clock_synchronised: bool | None = None
    """Whether the machine's clock was kept right by a time server when the document was made; None: not known."""
    clock_max_error_s: float | None = None
    time_zone: str = ""
    utc_offset_s: int = 0
    """Local time of the station minus UTC, s."""


class Origin(BaseModel):
    """Where an imported run was filmed. Such a run is not announced: it is no board of this line."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    station: str
    """Name of the station that filmed it."""
    exported: str
    """Time of the export, UTC."""
    imported: str
    """Time of the import into this station's history, UTC."""
