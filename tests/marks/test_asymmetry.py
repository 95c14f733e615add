"""Standard deviations of undisturbed, covered and glaring marks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vaoi_station.marks.subpixel_localisation import Mark, locate_mark

PLACE, SIZE = np.array([60.3, 59.6]), 26.0
Paint = Callable[..., Any]


def marked(paint: Paint, shape: str = "circle", **light: float) -> Any:
    return paint([(shape, *PLACE, SIZE)], size=(120, 120), **light)


def found(picture: Any, shape: Any = "circle") -> Mark:
    mark = locate_mark(picture, PLACE + 1.0, shape, SIZE)
    assert isinstance(mark, Mark)
    return mark


@pytest.mark.parametrize("shape", ["circle", "square", "diamond", "cross"])
@pytest.mark.parametrize(("contrast", "noise"), [(150.0, 0.0), (150.0, 3.0), (60.0, 3.0)])
def test_the_sigma_of_an_undisturbed_mark_is_that_of_its_noise(
    paint: Paint, shape: str, contrast: float, noise: float
) -> None:
    mark = found(marked(paint, shape, mark=60 + contrast, noise=noise), shape)
    assert mark.sigma_px < 0.01 + 0.8 * noise / contrast
    assert np.hypot(*(mark.px - PLACE)) < 4 * mark.sigma_px + 0.01


def test_vignetting_does_not_increase_sigma(paint: Paint) -> None:
    y, x = np.mgrid[:120, :120]
    picture = marked(paint) * (1 + 0.001 * (x - 60) - 0.0005 * (y - 60))
    assert found(picture.clip(0, 255).astype(np.uint8)).sigma_px < 0.02


@pytest.mark.parametrize("covered", [0.38, 0.34, 0.3])
@pytest.mark.parametrize("turn", [0, 1])
def test_the_sigma_of_a_covered_mark_covers_its_error(paint: Paint, covered: float, turn: int) -> None:
    picture = marked(paint)
    from_px = round(PLACE[turn] + covered * SIZE)
    if turn:
        picture[from_px:, :] = 60
    else:
        picture[:, from_px:] = 60
    mark = locate_mark(picture, PLACE, "circle", SIZE)
    if isinstance(mark, Mark):
        assert np.hypot(*(mark.px - PLACE)) < 3 * mark.sigma_px
        assert mark.sigma_px > 0.1


@pytest.mark.parametrize("levels", [60, 120, 180])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_the_sigma_of_a_mark_in_glare_covers_its_error(paint: Paint, levels: float, angle: float) -> None:
    y, x = np.mgrid[:120, :120]
    u, v = (x - PLACE[0]) / SIZE - 0.45 * np.cos(angle), (y - PLACE[1]) / SIZE - 0.45 * np.sin(angle)
    picture = (marked(paint) + levels * np.exp(-2 * (u**2 + v**2))).clip(0, 255).astype(np.uint8)
    mark = locate_mark(picture, PLACE, "circle", SIZE)
    if isinstance(mark, Mark):
        assert np.hypot(*(mark.px - PLACE)) < (3 if levels < 180 else 5) * mark.sigma_px
        assert levels < 180 or mark.sigma_px > 0.5, "half of it is saturated: its weight must vanish"


@pytest.mark.parametrize("angle", [0.3, 1.9, 4.0])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_residuals_of_a_glint_do_not_hide_it(paint: Paint, angle: float, noise: float) -> None:
    """As in the drawings 82340 and 84655 of the hostile suite: a spot of a few pixels at the edge of a small mark."""
    size, (x, y) = 18.0, PLACE
    picture = paint([("circle", *PLACE, size)], size=(120, 120), noise=noise).astype(float)
    v, u = np.mgrid[:120, :120]
    far = np.hypot(u - x - 11.0 * np.cos(angle), v - y - 11.0 * np.sin(angle))
    picture += 30 * np.exp(-((far / 5.0) ** 2))
    mark = locate_mark(picture.clip(0, 255).astype(np.uint8), PLACE, "circle", size)
    assert isinstance(mark, Mark)
    error = np.hypot(*(mark.px - PLACE))
    assert error > 0.02, "the glint displaces the centre"
    assert mark.sigma_px > error
