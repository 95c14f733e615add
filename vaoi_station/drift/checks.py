"""The stored drift check of a run: a small record, from which drift is detected and N_i can be corrected later."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from vaoi_station.geometry import Camera
from vaoi_station.geometry.camera_error import place_sigma_px, uncalibrated
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Strict
from vaoi_station.stitching.adjustment.cameras import STILL_PX, Attribution, attribute_motion

_SEEN = 4
"""A camera with at least this number of links to neighbouring cameras counts as seen in a run."""


class CameraCheck(Strict):
    """The displacement of one camera against its calibration, estimated from one run, in px of the camera's frame."""

    x_px: float
    y_px: float
    turn_px: float
    """Turn about the middle of the frame, expressed as the distance by which a corner of the frame moves."""
    sigma_px: tuple[float, float, float]
    """Standard deviations of x, y and turn, px."""
    rms_px: float | None
    """Rms residual of links to neighbouring cameras and of fiducials, with the calibrated cameras; None without any."""
    left_px: float | None
    """Rms of the same residuals after the estimated displacements of all cameras are applied."""
    links: int
    """Number of links to neighbouring cameras."""
    fiducials: int
    """Number of detections of fiducials in the camera's frames."""

    @property
    def displacement_px(self) -> Floats:
        """The displacement as an array (3,): x, y, turn."""
        return np.array([self.x_px, self.y_px, self.turn_px])

    @property
    def seen(self) -> bool:
        """Whether the run has enough links or fiducials to estimate the displacement of this camera."""
        return self.links >= _SEEN or self.fiducials > 0


class LampBaseline(Strict):
    """The brightness of the first boards of a type in one camera under one light, at one exposure."""

    brightness: Annotated[float, Field(gt=0)]
    """Median of grey level / (exposure · gain)."""
    scatter: float
    """Second-largest deviation of the logarithm of a run's brightness from that of the median."""
    grey: float
    """Median grey level."""
    points: float
    """Median number of samples."""


class LampCheck(Strict):
    """How bright a run shows the board in one camera under one light, at one exposure."""

    camera: int
    light: str
    """Name of the light; an empty text if the lights have no names."""
    exposure: Annotated[float, Field(gt=0)]
    """Exposure time in µs, times gain."""
    grey: float
    """Robust mean of the board's grey levels, 0 … 255. Divided by `exposure` it is the brightness."""
    points: int
    """Number of samples."""
    baseline: LampBaseline | None = None
    """What the brightness is compared with; None for the first runs of a board type. It is stored with every run, so
    that it stays the same when the first runs are deleted."""


class RunCheck(Strict):
    """The stored drift check of one run: the state of every camera, and the normal equations of the displacements.

    `information` and `vector` are those of `estimate.DisplacementEstimate`.
    """

    run: str
    time: str
    board_type: str
    """Name or digest of the board type. Runs of one board type have systematic displacements in common."""
    cameras: tuple[CameraCheck, ...]
    rivals: tuple[int, ...]
    """Cameras that may have moved instead of those that show a displacement."""
    information: tuple[float, ...]
    """Lower triangle of the symmetric information matrix, row by row, px⁻²."""
    vector: tuple[float, ...]
    lamps: tuple[LampCheck, ...] = ()
    """Brightness of the board per camera, light and exposure; empty in checks of recordings."""

    def normal_equations(self) -> tuple[Floats, Floats]:
        """Return the information matrix (3n, 3n) and the vector (3n,) of n cameras."""
        n = len(self.vector)
        matrix = np.zeros((n, n))
        matrix[np.tril_indices(n)] = self.information
        return matrix + np.tril(matrix, -1).T, np.array(self.vector)


class KeptBaselines(Strict):
    """The brightness of all board types under one calibration, as it is stored over restarts."""

    calibration: str
    """Digest of the calibration."""
    types: tuple[RunCheck, ...]
    """One entry for each board type, `only_baselines`; the type that was filmed last is the last one."""


def still_px(cameras: Sequence[Camera]) -> Floats:
    """Return the standard deviation (n,) px of the displacement of cameras that were not moved since calibration.

    That of a camera that is not calibrated is what the calibration states: links to it then say nothing against others.
    """
    vague, px = uncalibrated(cameras), np.full(len(cameras), STILL_PX)
    px[list(vague)] = [place_sigma_px(cameras[i].covariance_px2) for i in vague]
    return px


def combine_runs(checks: Sequence[RunCheck], still_px: Floats | float = STILL_PX) -> Attribution:
    """Estimate the displacements of the cameras from several runs together."""
    # The normal equations of independent runs can be added. So only these are stored, not the links of old runs.
    size = PARAMETERS * len(checks[0].cameras)
    information, vector = np.zeros((size, size)), np.zeros(size)
    for check in checks:
        i, v = check.normal_equations()
        information, vector = information + i, vector + v
    return attribute_motion(information, vector, still_px)
