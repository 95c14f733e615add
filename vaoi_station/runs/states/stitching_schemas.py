"""Schemas of how the runs of a board type are stitched: the method, and the reference run."""

from __future__ import annotations

from typing import Literal

from vaoi_station.config import MethodName
from vaoi_station.runs.states.schemas import Reason, Schema


class ReferenceRecord(Schema):
    """A run that is kept as the reference of its board type."""

    run: str
    taught: str
    calibration: str
    """Digest of the calibration with which the run was filmed."""
    cameras: int
    rows: int
    frames: int
    """Number of frames that are kept: a small set from each row."""
    size_bytes: int
    cad_sigma_px: float | None
    """Standard deviation of positions by the run's CAD mapping, at the board's worst corner; None if unknown."""


class ReferenceStatus(ReferenceRecord):
    """The reference of a board type, and whether boards can be placed against it now."""

    board_type: str
    usable: bool
    fault: Reason | None = None
    """Reason why the reference is not usable; None if it is usable."""


class StitchingMethod(Schema):
    """The method by which runs of a board type are stitched."""

    method: MethodName
    chosen: Literal["board-type", "station"]
    """Origin of the method: it was set for the board type, or it is the station's method."""
