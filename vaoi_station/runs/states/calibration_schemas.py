"""Documents about the calibration: frozen schemas, dumped to JSON unchanged.

Displacements are in px of the camera's own frame, relative to the calibration in force: (x, y) of the frame's centre,
and turn, the displacement of a corner by rotation.
"""

from __future__ import annotations

from typing import Literal

from vaoi_station.runs.states.schemas import Schema


class CameraDrift(Schema):
    """Displacement of a camera since its calibration."""

    size_px: float
    """Root mean square over the frame."""
    x_px: float
    y_px: float
    turn_px: float
    since_run: str
    """The first run that shows it."""
    since: str
    runs: int
    """Runs that show it."""
    instead: tuple[int, ...] = ()
    """Cameras that may have moved instead; pictures of boards cannot distinguish them."""


class CameraMoment(Schema):
    """One camera in one run."""

    run: str
    time: str
    x_px: float
    y_px: float
    turn_px: float
    sigma_px: float
    """The largest standard deviation of the three."""
    rms_px: float | None = None
    """Residuals of links to its neighbours and of fiducials; None without any."""
    links: int
    fiducials: int


class CameraCalibration(Schema):
    """State of one camera relative to its calibration."""

    camera: int
    name: str
    state: Literal["steady", "drifted", "unseen", "unknown"]
    """"unseen": the latest runs give no evidence of it; "unknown": no run has been checked yet."""
    drift: CameraDrift | None = None
    history: tuple[CameraMoment, ...] = ()
    """The latest runs, oldest first."""


class CalibrationStatus(Schema):
    """The calibration in force, and the state of every camera."""

    digest: str
    """Digest of its content, as in the documents of runs."""
    created: str | None = None
    runs: int
    """Number of runs checked since it is in force."""
    cameras: tuple[CameraCalibration, ...]
