from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.calibration.camera_prior import CameraPrior
from vaoi_station.calibration.homography_fit import (
    CORRELATED_MARKS,
    MARK_SIGMA_PX,
    Fit,
    fit_camera,
)
from vaoi_station.geometry import Lens
from vaoi_station.geometry.camera_error import basis_fields
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

CENTER, RADIUS = (695.5, 519.5), 868.8
PRIOR = CameraPrior(CENTER, RADIUS, 40.0, 483.0)
FRAME = np.stack(np.meshgrid(np.linspace(0, 1391, 9), np.linspace(0, 1039, 9)), -1).reshape(-1, 2)


def _matrix(x_mm: float, turn: float, tilt_x: float, tilt_y: float) -> Floats:
    """A camera 483 mm above (x, 0) at 40 px/mm."""
    c, s = math.cos(turn), math.sin(turn)
    up = np.array([[40 * c, -40 * s, CENTER[0]], [40 * s, 40 * c, CENTER[1]], [tilt_x / 483, tilt_y / 483, 1]])
    n = up @ np.array([[1, 0, -x_mm], [0, 1, 0], [0, 0, 1.0]])
    return np.asarray(n / n[2, 2])


def _grid(x_mm: float, columns: int = 5, rows: int = 4) -> Floats:
    x, y = np.linspace(-13, 13, columns) + x_mm, np.linspace(-9, 9, rows)
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def _fit(marks_mm: Floats, px: Floats) -> Fit:
    fit = fit_camera(marks_mm, px, PRIOR)
    assert isinstance(fit, Fit)
    return fit


@given(
    x_mm=st.floats(-500, 500),
    turn=st.floats(-0.1, 0.1),
    tilts=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    a1=st.sampled_from([0.0, -0.002, 0.01]),
)
def test_exact_marks_give_the_exact_camera(x_mm: float, turn: float, tilts: tuple[float, float], a1: float) -> None:
    n, lens = _matrix(x_mm, turn, *tilts), Lens(CENTER, RADIUS, (a1,) if a1 else ())
    marks = _grid(x_mm)
    fit = _fit(marks, lens.distort(apply(n, marks)))
    off = apply(n, apply(np.linalg.inv(fit.matrix), fit.lens.undistort(FRAME))) - lens.undistort(FRAME)
    # The prior draws a lens of 8.7 px towards zero, by much less than marks are measured.
    assert np.abs(off).max() < (1e-3 if a1 else 1e-4)
    assert fit.lens.radial[0] == pytest.approx(a1, abs=1e-6)


@pytest.mark.parametrize("a1", [0.0, -0.001])
def test_the_covariance_is_that_of_many_repetitions(a1: float) -> None:
    """Offsets over the frame, in units of what the covariance predicts, have mean square 1.

    But for what it is raised by for errors that marks have in common; these here are independent.
    """
    n, lens, marks = _matrix(66, -0.004, 0.002, 0.001), Lens(CENTER, RADIUS, (a1,) if a1 else ()), _grid(66, 7, 6)
    g, scores = np.random.default_rng(5), []
    for _ in range(60):
        fit = _fit(marks, lens.distort(apply(n, marks)) + g.normal(0, MARK_SIGMA_PX, marks.shape))
        if len(fit.lens.radial) != 1:
            continue  # a second coefficient seen by chance
        off = apply(fit.matrix, apply(np.linalg.inv(n), lens.undistort(FRAME))) - fit.lens.undistort(FRAME)
        scores.append(((off**2).sum(1) / fit.sigma_at_px(FRAME) ** 2).mean())
    assert len(scores) > 55
    assert 0.75 < np.mean(scores) * (1 + len(marks) / CORRELATED_MARKS) < 1.3


def test_the_first_coefficient_is_always_estimated_and_the_second_only_if_significant() -> None:
    n, bent = _matrix(0, 0, 0, 0), Lens(CENTER, RADIUS, (-0.0012,))
    g = np.random.default_rng(1)

    def lens(marks: Floats, lens: Lens) -> tuple[float, ...]:
        px = lens.distort(apply(n, marks)) + g.normal(0, 0.005, marks.shape)
        return _fit(marks, px).lens.radial

    assert lens(_grid(0, 3, 3), bent) == pytest.approx([-0.0012], abs=1e-4)
    assert lens(_grid(0, 7, 7), bent) == pytest.approx([-0.0012], abs=5e-5)
    assert len(lens(_grid(0, 7, 7), Lens(CENTER, RADIUS, (-0.01, 0.02)))) == 2
    assert sum(len(lens(_grid(0, 7, 7), Lens(CENTER, RADIUS))) - 1 for _ in range(20)) <= 1


def test_the_covariance_of_the_field_is_that_of_many_repetitions() -> None:
    n, lens, marks = _matrix(66, -0.004, 0.002, 0.001), Lens(CENTER, RADIUS, (-0.001,)), _grid(66, 5, 4)
    g, scores = np.random.default_rng(7), []
    for _ in range(100):
        fit = _fit(marks, lens.distort(apply(n, marks)) + g.normal(0, MARK_SIGMA_PX, marks.shape))
        seen = fit.lens.undistort(FRAME)
        error = seen - apply(fit.matrix, apply(np.linalg.inv(n), lens.undistort(FRAME)))
        basis = basis_fields((seen - CENTER) / RADIUS)
        c = np.linalg.lstsq(basis.reshape(-1, 9), error.ravel(), rcond=None)[0]
        scores.append(c @ np.linalg.solve(fit.field_covariance_px2, c) / 9)
    assert 0.6 < np.mean(scores) * (1 + len(marks) / CORRELATED_MARKS) < 1.3


@pytest.mark.parametrize(
    ("marks", "reason"),
    [
        ([(0, 0), (10, 0), (0, 10)], "3 marks do not determine"),
        ([(0, 0), (5, 0.01), (10, 0), (15, 0)], "its 4 marks are collinear: they lie within 0.00 mm"),
        ([(0, 0), (5, 0), (10, 0), (15, 0), (3, 9)], "all but one of its 5 marks are collinear"),
    ],
)
def test_marks_that_determine_no_plane_are_refused(marks: list[tuple[float, float]], reason: str) -> None:
    places = np.array(marks, dtype=np.float64)
    failure = fit_camera(places, places * 40, PRIOR)
    assert isinstance(failure, Failure)
    assert reason in failure.reason
