from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest

from vaoi_station.marks.mark_shape import Shape
from vaoi_station.marks.template_correlation import SHAPE_CODE, correlate_with_shape
from vaoi_station.stitching.matching.frames import read_only

SHAPES = get_args(Shape)
Paint = Callable[..., Any]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_score_is_the_weighted_correlation_with_the_shape(paint: Paint, shape: Shape) -> None:
    image, at = paint([(shape, 48.3, 40.6, 18.0)], noise=4.0), (48.3, 40.6)
    score, contrast = correlate_with_shape(read_only(image), *at, SHAPE_CODE[shape], 18.0, 0.25, 36.0)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    u, v = np.abs(x - at[0]), np.abs(y - at[1])
    outside = {
        "circle": np.hypot(u, v) - 9,
        "square": np.maximum(u, v) - 9,
        "diamond": (u + v - 9) / np.sqrt(2),
        "cross": np.minimum(np.maximum(u - 9, v - 2.25), np.maximum(u - 2.25, v - 9)),
    }[shape]
    t = np.clip(0.5 - outside / 2.85, 0, 1)
    q, w = t * t * (3 - 2 * t), np.clip(18.5 - np.hypot(u, v), 0, 1)
    p = image - np.average(image, weights=w)
    q = q - np.average(q, weights=w)
    assert contrast == pytest.approx((w * p * q).sum() / (w * q * q).sum(), rel=1e-9)
    assert score == pytest.approx((w * p * q).sum() / np.sqrt((w * p * p).sum() * (w * q * q).sum()), rel=1e-9)
    assert correlate_with_shape(
        read_only(np.full((80, 96), 7, np.uint8)), *at, SHAPE_CODE[shape], 18.0, 0.25, 36.0
    ) == (0.0, 0.0)


@pytest.mark.parametrize("painted", SHAPES)
def test_the_painted_shape_correlates_best(paint: Paint, painted: Shape) -> None:
    image = paint([(painted, 48.0, 40.0, 18.0)])
    scores = {s: correlate_with_shape(read_only(image), 48.0, 40.0, SHAPE_CODE[s], 18.0, 0.25, 36.0)[0] for s in SHAPES}
    assert max(scores, key=lambda s: scores[s]) == painted
    assert scores[painted] > 0.97


@pytest.mark.parametrize(("mark", "ground"), [(210.0, 60.0), (30.0, 170.0), (100.0, 90.0)])
def test_the_contrast_is_mark_minus_ground(paint: Paint, mark: float, ground: float) -> None:
    image = paint([("square", 48.0, 40.0, 20.0)], mark=mark, ground=ground)
    _, contrast = correlate_with_shape(read_only(image), 48.0, 40.0, SHAPE_CODE["square"], 20.0, 0.25, 36.0)
    assert contrast == pytest.approx(mark - ground, rel=0.1)


def test_outside_the_frame_nothing_correlates(paint: Paint) -> None:
    image = paint([("circle", 48.0, 40.0, 16.0)])
    assert correlate_with_shape(read_only(image), -200.0, 40.0, SHAPE_CODE["circle"], 16.0, 0.25, 32.0) == (0.0, 0.0)
