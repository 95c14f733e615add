"""What the station says of its calibration: frozen shapes, dumped to JSON as they stand.

Displacements are in px of the camera's own frame, against the calibration in force: of the middle of the picture
(x, y), and of its corner by a turn.
"""

from __future__ import annotations

from typing import Literal

from vaoi_station.runs.states.schemas import Shape


class CameraDrift(Shape):
    """A camera that no longer looks where it was calibrated."""

    size_px: float
    """Rms over the frame."""
    x_px: float
    y_px: float
    turn_px: float
    since_run: str
    """The first run that shows it."""
    since: str
    runs: int
    """Runs that show it."""
    instead: tuple[int, ...] = ()
    """Cameras that may have moved in its place; pictures of boards do not tell."""


class CameraMoment(Shape):
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


class CameraCalibration(Shape):
    """How one camera stands to its calibration."""

    camera: int
    name: str
    state: Literal["steady", "drifted", "unseen", "unknown"]
    """"unseen": the last runs told nothing of it; "unknown": no run has been looked at yet."""
    drift: CameraDrift | None = None
    history: tuple[CameraMoment, ...] = ()
    """The latest runs, oldest first."""


class CalibrationStatus(Shape):
    """The calibration in force, and how the cameras stand to it."""

    digest: str
    """Its name by its content, as runs carry it."""
    created: str | None = None
    runs: int
    """Runs that were looked at since it is in force."""
    cameras: tuple[CameraCalibration, ...]
