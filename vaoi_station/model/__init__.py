"""Immutable data models: recording, calibration, board type, frames of a run, and stitch (the result of stitching).

Shapes, units and names follow docs/formats.md; the room `files` reads and writes the models. Keys that begin with `x_`
are free for the user: the software keeps them and does not interpret them. Cameras and rows count from 0.
"""

from vaoi_station.model.board_identity import BoardCode, BoardIdentity, BoardReading, CodePlace
from vaoi_station.model.board_type import (
    MM_PER_UNIT,
    VISIBILITY,
    BoardLine,
    BoardType,
    Component,
    Fiducial,
    FixtureMarkShape,
    OtherMark,
    Place,
    Visibility,
)
from vaoi_station.model.calibration import Calibration, Distortion
from vaoi_station.model.frozen_model import Finite, FrozenModel, Positive, Strict, Whole
from vaoi_station.model.part_limits import BoardLimits, PartLimits
from vaoi_station.model.reason import Reason, ReasonCode
from vaoi_station.model.recording import (
    CameraHead,
    FrameRecord,
    Program,
    ProgramRow,
    ProgramStep,
    Pulse,
    RecordingHead,
    Verdict,
)
from vaoi_station.model.stitch_result import Status, Stitch, Surface

__all__ = [
    "MM_PER_UNIT",
    "VISIBILITY",
    "BoardCode",
    "BoardIdentity",
    "BoardLimits",
    "BoardLine",
    "BoardReading",
    "BoardType",
    "Calibration",
    "CameraHead",
    "CodePlace",
    "Component",
    "Distortion",
    "Fiducial",
    "Finite",
    "FixtureMarkShape",
    "FrameRecord",
    "FrozenModel",
    "OtherMark",
    "PartLimits",
    "Place",
    "Positive",
    "Program",
    "ProgramRow",
    "ProgramStep",
    "Pulse",
    "Reason",
    "ReasonCode",
    "RecordingHead",
    "Status",
    "Stitch",
    "Strict",
    "Surface",
    "Verdict",
    "Visibility",
    "Whole",
]
