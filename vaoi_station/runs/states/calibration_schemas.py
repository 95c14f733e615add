"""Schemas of the documents about the calibration. The documents are immutable and become JSON without conversion.

Displacements are in pixels of the camera's frame, relative to the calibration in force: x and y are the displacement of
the frame's centre, and `turn` is the displacement of a corner of the frame by rotation.
"""

from __future__ import annotations

from typing import Literal

from vaoi_station.runs.states.schemas import Schema


class CameraDrift(Schema):
    """Displacement of a camera since its calibration."""

    size_px: float
    """Root mean square of the displacement over all pixels of the frame."""
    x_px: float
    y_px: float
    turn_px: float
    since_run: str
    """Id of the first run that shows the displacement."""
    since: str
    runs: int
    """Number of runs that show the displacement."""
    instead: tuple[int, ...] = ()
    """Indices of cameras that may have moved instead of this one; pictures of boards cannot show which has moved."""


class CameraMoment(Schema):
    """Displacement of one camera in one run."""

    run: str
    time: str
    x_px: float
    y_px: float
    turn_px: float
    sigma_px: float
    """The largest of the standard deviations of x, y and turn."""
    rms_px: float | None = None
    """Root mean square residual of the camera's links to its neighbours and of its fiducials; None without both."""
    links: int
    fiducials: int


class CameraCalibration(Schema):
    """The state of one camera since its calibration, and its displacement in each of the latest runs."""

    camera: int
    name: str
    state: Literal["steady", "drifted", "unseen", "unknown"]
    """"steady" or "drifted"; "unseen": the latest runs give no evidence of the camera's position; "unknown": no run was
    checked."""
    drift: CameraDrift | None = None
    history: tuple[CameraMoment, ...] = ()
    """The camera in each of the latest runs, oldest first."""


class CalibrationStatus(Schema):
    """The calibration in force, and the state of every camera."""

    digest: str
    """Digest of the calibration's content; the documents of runs refer to the calibration by it."""
    created: str | None = None
    runs: int
    """Number of runs that were checked against this calibration."""
    cameras: tuple[CameraCalibration, ...]
