from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from vaoi_station.geometry.robust import Failure
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.marks.mark_shape import Shape

SHAPES = get_args(Shape)
Paint = Callable[..., Any]
fraction = st.floats(-0.5, 0.5)
QUICK = settings(max_examples=10, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
@QUICK
@given(at=st.tuples(fraction, fraction), size=st.floats(10, 24), off=st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
def test_a_clean_mark_is_found_to_two_hundredths_of_a_pixel(
    paint: Paint, shape: Shape, light: bool, at: tuple[float, float], size: float, off: tuple[float, float]
) -> None:
    truth = np.array([48, 40]) + at
    grey = {"mark": 210.0, "ground": 60.0} if light else {"mark": 30.0, "ground": 170.0}
    found = locate_mark(paint([(shape, *truth, size)], **grey), truth + off, shape, size)
    assert isinstance(found, Mark), found
    assert np.hypot(*(found.px - truth)) <= 0.02
    assert found.light is light
    assert found.score > 0.9
    assert 0 < found.sigma_px < 0.1


@pytest.mark.parametrize("shape", SHAPES)
def test_the_position_has_no_bias_towards_whole_pixels(paint: Paint, shape: Shape) -> None:
    bias = []
    for f in np.arange(0, 1, 0.125):
        truth = np.array([48 + f, 40.25])
        found = locate_mark(paint([(shape, *truth, 16.0)]), truth + 0.4, shape, 16.0)
        assert isinstance(found, Mark)
        bias.append(found.px[0] - truth[0])
    print(shape, "bias over the fraction, px:", " ".join(f"{b:+.4f}" for b in bias))
    assert np.abs(bias).max() <= 0.015


@pytest.mark.parametrize("shape", SHAPES)
def test_the_scatter_by_noise_agrees_with_sigma(paint: Paint, shape: Shape) -> None:
    g, truth, errors, sigmas = np.random.default_rng(2), np.array([48.3, 39.8]), [], []
    clean = paint([(shape, *truth, 16.0)]).astype(float)
    for _ in range(40):
        image = np.clip(np.round(clean + g.normal(0, 3, clean.shape)), 0, 255).astype(np.uint8)
        found = locate_mark(image, truth + g.uniform(-1, 1, 2), shape, 16.0)
        assert isinstance(found, Mark)
        errors.append(found.px - truth)
        sigmas.append(found.sigma_px)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(shape, f"rms {rms:.4f} px, claimed {np.mean(sigmas):.4f} px")
    assert rms < 0.04
    assert rms < 4 * np.mean(sigmas)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_frame_without_a_mark_fails_with_a_reason(shape: Shape) -> None:
    flat = np.full((80, 96), 90, dtype=np.uint8)
    grainy = np.random.default_rng(0).normal(90, 2, (80, 96)).round().astype(np.uint8)
    for image in (flat, grainy):
        refused = locate_mark(image, np.array([48.0, 40.0]), shape, 16.0)
        assert isinstance(refused, Failure)
        assert refused.reason


@pytest.mark.parametrize("painted", SHAPES)
@pytest.mark.parametrize("sought", SHAPES)
def test_a_mark_of_another_shape_is_refused_or_scores_far_less(paint: Paint, painted: Shape, sought: Shape) -> None:
    found = locate_mark(paint([(painted, 48, 40, 16.0)]), np.array([48.0, 40.0]), sought, 16.0)
    if painted == sought:
        assert isinstance(found, Mark)
        assert found.score > 0.97
    else:
        assert isinstance(found, Failure) or found.score < 0.93, found


def test_the_sigma_of_a_partly_covered_disc_covers_its_error(paint: Paint) -> None:
    image = paint([("circle", 48, 40, 30.0)])
    image[:, 54:] = 60
    found = locate_mark(image, np.array([48.0, 40.0]), "circle", 30.0)
    assert isinstance(found, Mark)
    assert np.hypot(*(found.px - (48, 40))) < 4 * found.sigma_px


@pytest.mark.parametrize("place", [(8, 40), (48, 6), (90, 40), (48, 77), (-30, 40), (48, 400)])
def test_a_mark_cut_off_by_the_border_is_refused(paint: Paint, place: tuple[int, int]) -> None:
    refused = locate_mark(paint([("circle", *place, 16.0)]), np.array(place, dtype=float), "circle", 16.0)
    assert isinstance(refused, Failure)
    assert f"the mark at {place} px is cut off by the frame's border" in refused.reason
