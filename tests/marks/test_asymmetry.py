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
        assert mark.sigma_px > 0.02


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
    assert error < 0.05, "what the glint brightens has no part in the centre"
    assert 2 * mark.sigma_px > error


@pytest.mark.parametrize("angle", [0.3, 1.9, 4.0])
@pytest.mark.parametrize("strength", [0.2, 0.6, 1.0])
def test_a_smudge_on_one_side_of_a_disc_costs_neither_place_nor_certainty(
    paint: Paint, angle: float, strength: float
) -> None:
    y, x = np.mgrid[:120, :120]
    far = np.hypot(x - PLACE[0] - 0.7 * SIZE * np.cos(angle), y - PLACE[1] - 0.7 * SIZE * np.sin(angle))
    film = strength * np.clip((0.4 * SIZE - far) / 3, 0, 1)
    picture = np.round(marked(paint, noise=1.5) * (1 - film) + 130 * film).astype(np.uint8)
    mark = locate_mark(picture, PLACE + 1.0, "circle", SIZE)
    assert isinstance(mark, Mark)
    error = np.hypot(*(mark.px - PLACE))
    assert error < 0.03
    assert error / 3 < mark.sigma_px < 0.15


@pytest.mark.parametrize("shift", [0.08, 0.15])
def test_a_disc_whose_edge_is_covered_nearly_all_around_is_not_called_certain(paint: Paint, shift: float) -> None:
    """A cover over most of the edge leaves too little of it: the centre of what is left is not that of the mark."""
    y, x = np.mgrid[:120, :120]
    hidden = np.hypot(x - PLACE[0] - shift * SIZE, y - PLACE[1]) > 0.42 * SIZE
    picture = marked(paint).astype(float)
    picture[hidden & (x < PLACE[0] + 0.3 * SIZE)] = 45
    mark = locate_mark(picture.astype(np.uint8), PLACE, "circle", SIZE)
    if isinstance(mark, Mark):
        assert np.hypot(*(mark.px - PLACE)) < 3 * mark.sigma_px or mark.sigma_px > 0.1
