"""The stored check of a run: what it keeps of an estimate, and how several runs are combined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.drift.check_run import make_run_check
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.estimate import DisplacementEstimate


def estimate(displacement_px: np.ndarray, sigma_px: float = 0.02, **keys: np.ndarray) -> DisplacementEstimate:
    """Differences of neighbouring cameras, each known to `sigma_px`."""
    n = len(displacement_px)
    a = np.zeros((3 * n - 3, 3 * n))
    for k in range(3 * n - 3):
        a[k, k], a[k, k + 3] = -1 / sigma_px, 1 / sigma_px
    vector = a.T @ a @ displacement_px.ravel()
    values = {"rms": np.full(n, 0.123456789), "left": np.full(n, 0.1), "links": np.full(n, 40), "marks": np.zeros(n)}
    values |= keys
    return DisplacementEstimate(
        a.T @ a, vector, values["rms"], values["left"], values["links"], values["marks"].astype(np.int_)
    )


def moved(camera: int, *by: float, n: int = 4) -> np.ndarray:
    d = np.zeros((n, 3))
    d[camera] = by
    return d


@given(st.lists(st.floats(-30, 30), min_size=12, max_size=12), st.floats(0.005, 0.5))
def test_the_equations_survive_the_text_that_is_stored(values: list[float], sigma_px: float) -> None:
    exact = estimate(np.array(values).reshape(4, 3), sigma_px)
    check = RunCheck.model_validate_json(make_run_check("r", "t", "b", exact).model_dump_json())
    information, vector = check.normal_equations()
    np.testing.assert_allclose(information, exact.information, rtol=1e-6)
    np.testing.assert_allclose(vector, exact.vector, rtol=1e-6, atol=1e-12)
    assert np.array_equal(information, information.T)


@pytest.mark.parametrize(("links", "fiducials", "seen"), [(4, 0, True), (3, 0, False), (0, 1, True), (0, 0, False)])
def test_a_camera_is_seen_by_enough_links_or_a_fiducial(links: int, fiducials: int, seen: bool) -> None:
    found = estimate(moved(0, 0, 0, 0), links=np.full(4, links), marks=np.full(4, fiducials))
    assert make_run_check("r", "t", "b", found).cameras[1].seen is seen
