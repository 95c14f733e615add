"""What is kept of every run about its cameras: small, and enough to tell a drift and to correct N_i later."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from vaoi_station.drift.attribution import Attribution, attribute_motion
from vaoi_station.drift.displacement import PARAMETERS
from vaoi_station.drift.equations import DisplacementEstimate
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Strict

_DIGITS = 7
_SEEN = 4
"""Links to neighbours from which a camera is worth a judgement."""


class CameraCheck(Strict):
    """One camera in one run; displacements in px of its frame against its calibration."""

    x_px: float
    y_px: float
    turn_px: float
    """At the corner of the frame."""
    sigma_px: tuple[float, float, float]
    """Standard deviations of x, y and turn."""
    rms_px: float | None
    """Residuals of links to its neighbours and of fiducials under the calibration; None without any."""
    left_px: float | None
    """The same when the displacements of all cameras are taken out."""
    links: int
    """To neighbours."""
    fiducials: int

    @property
    def displacement_px(self) -> Floats:
        """(3,) x, y, turn."""
        return np.array([self.x_px, self.y_px, self.turn_px])

    @property
    def seen(self) -> bool:
        """Whether the run tells anything of this camera's place."""
        return self.links >= _SEEN or self.fiducials > 0


class RunCheck(Strict):
    """One run; `information` and `vector` are those of `equations.Told`."""

    run: str
    time: str
    board_type: str
    """Name or digest: boards of one type have the same habits."""
    cameras: tuple[CameraCheck, ...]
    rivals: tuple[int, ...]
    """Cameras that may have moved instead of those that show a displacement."""
    information: tuple[float, ...]
    """Lower triangle of the symmetric matrix, row by row, px⁻²."""
    vector: tuple[float, ...]

    def told(self) -> tuple[Floats, Floats]:
        """Information (3n, 3n) and vector (3n,)."""
        n = len(self.vector)
        matrix = np.zeros((n, n))
        matrix[np.tril_indices(n)] = self.information
        return matrix + np.tril(matrix, -1).T, np.array(self.vector)


def make_run_check(run: str, time: str, board_type: str, told: DisplacementEstimate) -> RunCheck:
    """What is kept of a run."""
    found = attribute_motion(told.information, told.vector)
    return RunCheck(
        run=run,
        time=time,
        board_type=board_type,
        cameras=tuple(_camera(told, found, i) for i in range(len(told.links))),
        rivals=found.rivals,
        information=_short(told.information[np.tril_indices(len(told.vector))]),
        vector=_short(told.vector),
    )


def _camera(told: DisplacementEstimate, found: Attribution, i: int) -> CameraCheck:
    x, y, turn = (round(float(v), 5) for v in found.displacement_px[i])
    sigma_x, sigma_y, sigma_turn = (round(float(v), 5) for v in found.sigma_px[i])
    return CameraCheck(
        x_px=x,
        y_px=y,
        turn_px=turn,
        sigma_px=(sigma_x, sigma_y, sigma_turn),
        rms_px=_known(told.rms_px[i]),
        left_px=_known(told.left_px[i]),
        links=int(told.links[i]),
        fiducials=int(told.fiducials[i]),
    )


def _known(value: float) -> float | None:
    return None if math.isnan(value) else round(float(value), 5)


def _short(values: Floats) -> tuple[float, ...]:
    return tuple(float(f"{v:.{_DIGITS}g}") for v in values)


def combine_runs(checks: Sequence[RunCheck]) -> Attribution:
    """The displacements that all these runs tell together."""
    size = PARAMETERS * len(checks[0].cameras)
    information, vector = np.zeros((size, size)), np.zeros(size)
    for check in checks:
        i, v = check.told()
        information, vector = information + i, vector + v
    return attribute_motion(information, vector)
