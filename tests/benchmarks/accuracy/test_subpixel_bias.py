"""Bias of links towards whole pixels."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.benchmarks.accuracy.subpixel_bias import FRACTIONS, BiasFigures, Texture, measure_subpixel_bias


@pytest.fixture(scope="module")
def figures() -> BiasFigures:
    return measure_subpixel_bias(noises=(0.0,))


def test_links_have_little_bias_towards_whole_pixels(figures: BiasFigures) -> None:
    assert [c.axis for c in figures.curves] == ["x", "y"]
    for curve in figures.curves:
        assert curve.fraction == FRACTIONS
        assert curve.largest_px <= 0.005
        assert max(abs(e) for e in curve.lucas_kanade_px) > 2 * curve.largest_px


def test_figures_have_lines_a_plot_and_a_document(figures: BiasFigures) -> None:
    lines = list(figures.lines())
    assert len(lines) == 2
    assert all("plain Lucas-Kanade" in line for line in lines)
    assert figures.plot().count("<polyline") == 6
    assert [curve["axis"] for curve in figures.document()["pulls"]] == ["x", "y"]


def test_texture_moves_by_exactly_the_shift() -> None:
    texture = Texture(np.random.default_rng(2))
    still, moved = texture.render((0.0, 0.0)), texture.render((3.0, -2.0))
    assert moved[:-2, 3:] == pytest.approx(still[2:, :-3], abs=1e-6)
    half = texture.render((0.5, 0.0))
    assert texture.render((1.0, 0.0)) != pytest.approx(half, abs=0.1)
    assert 20 < still.std() < 40
