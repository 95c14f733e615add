from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.calibration.camera_prior import CameraPrior
from vaoi_station.calibration.homography_fit import Fit, fit_camera
from vaoi_station.calibration.outlier_removal import remove_outliers
from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.transforms import Floats, apply

PRIOR = CameraPrior((695.5, 519.5), 868.8, 40.0, 483.0)
N = np.array([[40.0, 0.4, 695.5], [-0.4, 40.0, 519.5], [2e-6, -1e-6, 1.0]])
MARKS = np.stack(np.meshgrid(np.linspace(-13, 13, 5), np.linspace(-9, 9, 4)), -1).reshape(-1, 2)


def fit(marks: Floats, px: Floats) -> Fit:
    found = fit_camera(marks, px, PRIOR)
    assert isinstance(found, Fit)
    return found


def noisy(seed: int) -> Floats:
    return apply(N, MARKS) + np.random.default_rng(seed).normal(0, 0.005, MARKS.shape)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 999), wrong=st.sets(st.integers(0, 19), max_size=1), off=st.floats(0.5, 30))
def test_exactly_the_displaced_marks_are_removed(seed: int, wrong: set[int], off: float) -> None:
    px = noisy(seed)
    for k in wrong:
        px[k] += off * np.array([np.cos(k), np.sin(k)])
    found, kept = remove_outliers(fit(MARKS, px), MARKS, px)
    assert set(range(20)) - set(kept) == wrong
    assert found.rms_px < 0.02
    assert len(found.residuals_px) == len(kept)


@pytest.mark.parametrize("seed", range(4))
def test_outliers_that_mask_each_other_are_removed(seed: int) -> None:
    """With three of five marks of an edge no single one is inconsistent with all others."""
    px = noisy(seed)
    px[[0, 3, 4]] += np.array([[3.0, 0.0], [-3.0, 0.4], [-2.0, -2.3]])
    found, kept = remove_outliers(fit(MARKS, px), MARKS, px)
    assert sorted(set(range(20)) - set(kept)) == [0, 3, 4]
    assert found.rms_px < 0.02


@pytest.mark.parametrize("seed", range(8))
def test_two_fifths_of_bad_marks_are_removed_behind_a_lens_that_distorts(seed: int) -> None:
    g = np.random.default_rng(seed)
    lens = Lens(PRIOR.center_px, PRIOR.radius_px, (-0.002,))
    px = np.asarray(lens.distort(apply(N, MARKS))) + g.normal(0, 0.005, MARKS.shape)
    bad = g.choice(20, 8, replace=False)
    px[bad] += g.normal(0, 5, (8, 2)) + 2
    _, kept = remove_outliers(fit(MARKS, px), MARKS, px)
    assert not set(kept) & set(bad.tolist())
    assert len(kept) == 12


def test_at_most_two_fifths_of_the_marks_are_removed() -> None:
    px = noisy(2)
    px[:12] += np.random.default_rng(3).normal(0, 20, (12, 2))
    _, kept = remove_outliers(fit(MARKS, px), MARKS, px)
    assert len(kept) >= 12
