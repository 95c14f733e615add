"""Matches of simulated texture are accurate, unbiased and honest about their uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.stitching.matching.patches import REACH_PX, Matches, are_inside_both, match_patches, patch_centres

SIZE = (360, 300)
FRACTIONS = np.arange(10) / 10


def grid() -> NDArray[np.int_]:
    y, x = np.mgrid[40:260:24, 40:320:24]
    return np.stack([x.ravel(), y.ravel()], -1)


def shifted(workshop: Any, shift: tuple[float, float], seed: int = 1) -> tuple[NDArray[Any], NDArray[Any]]:
    waves = workshop.waves(seed)
    return waves.picture(*SIZE), waves.picture(*SIZE, shift)


def errors(found: Matches, at: NDArray[np.int_], shift: tuple[float, float]) -> NDArray[np.float64]:
    return found.b_px - patch_centres(at) - shift


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("seed", [1, 2])
def test_there_is_hardly_any_bias_towards_whole_pixels(workshop: Any, axis: int, seed: int) -> None:
    bias = []
    for fraction in FRACTIONS:
        shift = (fraction + 3, -2.3) if axis == 0 else (1.7, fraction - 3)
        at = grid()
        found = match_patches(*shifted(workshop, shift, seed), at, patch_centres(at) + np.round(shift))
        assert found.found.all()
        error = errors(found, at, shift)
        assert np.hypot(*error.T).max() < 0.04
        bias.append(error[:, axis].mean())
    print("bias over the fraction, px:", " ".join(f"{b:+.4f}" for b in bias))
    assert np.abs(bias).max() <= 0.005


@settings(max_examples=12, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    gain=st.floats(0.5, 1.2),
    offset=st.floats(-15, 15),
    slope=st.floats(-0.03, 0.03),
    shift=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
def test_gain_offset_and_slope_of_light_do_not_matter(
    workshop: Any, gain: float, offset: float, slope: float, shift: tuple[float, float]
) -> None:
    waves = workshop.waves(3)
    a = waves.picture(*SIZE)
    lamp = offset + slope * (np.arange(SIZE[0]) - SIZE[0] / 2)
    grey = 128 + gain * (waves.levels(*SIZE, shift) - 128) + lamp
    at = grid()
    found = match_patches(a, workshop.digitised(grey), at, patch_centres(at) + np.round(shift))
    assert found.found.mean() > 0.8
    error = errors(found, at, shift)[found.found]
    assert np.abs(np.median(error, axis=0)).max() <= 0.012
    assert np.hypot(*error.T).max() < 0.12


def test_saturated_patches_are_not_found(workshop: Any) -> None:
    waves = workshop.waves(4)
    a, at = waves.picture(*SIZE), grid()
    glare = np.where(np.arange(SIZE[0]) > 200, 4.0, 1.0)
    bright = workshop.digitised(128 + glare * (waves.levels(*SIZE, (1.4, 0.0)) - 128))
    found = match_patches(a, bright, at, patch_centres(at) + np.array([1.0, 0]))
    clipped = np.array([(bright[v - 10 : v + 11, u + 1 - 10 : u + 1 + 11] >= 254).mean() for u, v in at])
    assert (clipped > 0.03).any()
    assert not found.found[clipped > 0.03].any()
    assert found.found[clipped == 0].mean() > 0.9


@pytest.mark.parametrize("off", [(3.0, -4.0), (5.0, 0.0)])
def test_a_prediction_may_be_wrong_by_a_few_pixels(workshop: Any, off: tuple[float, float]) -> None:
    shift, at = (2.35, 1.6), grid()
    found = match_patches(*shifted(workshop, shift), at, patch_centres(at) + np.round(shift) + off)
    assert found.found.mean() > 0.95
    assert np.hypot(*errors(found, at, shift)[found.found].T).max() < 0.05


@pytest.mark.parametrize("off", [7.0, 9.0, 15.0])
def test_a_prediction_out_of_reach_never_gives_a_wrong_match_with_a_good_score(workshop: Any, off: float) -> None:
    assert off > REACH_PX
    shift, at = (2.0, 1.6), grid()
    at = at[are_inside_both(SIZE[::-1], SIZE[::-1], at, patch_centres(at) + np.round(shift) + (off, 0))]
    found = match_patches(*shifted(workshop, shift), at, patch_centres(at) + np.round(shift) + (off, 0))
    wrong = np.hypot(*errors(found, at, shift).T) > 0.2
    assert not (found.found & wrong & (found.score > 0.8)).any()
