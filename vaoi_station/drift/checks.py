"""The stored drift check of a run: a small record, from which drift is detected and N_i can be corrected later."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from vaoi_station.drift.estimate import DisplacementEstimate
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Strict
from vaoi_station.stitching.adjustment.cameras import Attribution, attribute_motion

_DIGITS = 7
"""Significant digits of stored matrices: more than the estimate's accuracy needs, half as long as full precision."""
_SEEN = 4
"""A camera with at least this number of links to neighbouring cameras counts as seen in a run."""


class CameraCheck(Strict):
    """The displacement of one camera against its calibration, estimated from one run, in px of the camera's frame."""

    x_px: float
    y_px: float
    turn_px: float
    """Turn about the middle of the frame, expressed as the distance by which a corner of the frame moves."""
    sigma_px: tuple[float, float, float]
    """Standard deviations of x, y and turn of the displacement, px."""
    rms_px: float | None
    """Rms residual of links to neighbouring cameras and of fiducials, with the calibrated cameras; None if none
    exist."""
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
    """Brightness of the board per camera, light and exposure; empty in checks of older versions and of recordings."""

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


def make_run_check(
    run: str, time: str, board_type: str, estimate: DisplacementEstimate, lamps: tuple[LampCheck, ...] = ()
) -> RunCheck:
    """Make the stored check of a run from the estimate of its cameras' displacements, and the brightness."""
    found = attribute_motion(estimate.information, estimate.vector)
    return RunCheck(
        run=run,
        time=time,
        board_type=board_type,
        cameras=tuple(_camera(estimate, found, i) for i in range(len(estimate.links))),
        rivals=found.rivals,
        information=_short(estimate.information[np.tril_indices(len(estimate.vector))]),
        vector=_short(estimate.vector),
        lamps=lamps,
    )


def _camera(estimate: DisplacementEstimate, found: Attribution, i: int) -> CameraCheck:
    x, y, turn = (round(float(v), 5) for v in found.displacement_px[i])
    sigma_x, sigma_y, sigma_turn = (round(float(v), 5) for v in found.sigma_px[i])
    return CameraCheck(
        x_px=x,
        y_px=y,
        turn_px=turn,
        sigma_px=(sigma_x, sigma_y, sigma_turn),
        rms_px=_rounded_or_none(estimate.rms_px[i]),
        left_px=_rounded_or_none(estimate.left_px[i]),
        links=int(estimate.links[i]),
        fiducials=int(estimate.fiducials[i]),
    )


def _rounded_or_none(value: float) -> float | None:
    return None if math.isnan(value) else round(float(value), 5)


def _short(values: Floats) -> tuple[float, ...]:
    return tuple(float(f"{v:.{_DIGITS}g}") for v in values)


def combine_runs(checks: Sequence[RunCheck]) -> Attribution:
    """Estimate the displacements of the cameras from several runs together."""
    # The normal equations of independent runs can be added. So only these are stored, not the links of old runs.
    size = PARAMETERS * len(checks[0].cameras)
    information, vector = np.zeros((size, size)), np.zeros(size)
    for check in checks:
        i, v = check.normal_equations()
        information, vector = information + i, vector + v
    return attribute_motion(information, vector)
