"""The plot of bias over the fraction of a pixel."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pytest

from vaoi_station.benchmarks.accuracy.bias_plot import Panel, draw_bias_panels

SVG = "{http://www.w3.org/2000/svg}"
FRACTIONS = tuple(float(f) for f in np.linspace(-0.5, 0.5, 5))


def curves(*panels: Panel) -> list[list[tuple[float, float]]]:
    """Return the points of the polylines: per panel the zero line, the other method and ours."""
    root = ElementTree.fromstring(draw_bias_panels(panels, "title & more", ("ours", "theirs")))
    lines = [p.attrib["points"].split() for p in root.iter(f"{SVG}polyline")]
    return [[(float(x), float(y)) for x, y in (point.split(",") for point in line)] for line in lines]


def panel(ours: tuple[float, ...], theirs: tuple[float | None, ...] = (0.0,) * 5) -> Panel:
    return Panel("along x", FRACTIONS, ours, theirs)


def test_curve_spans_the_panel_and_lies_on_zero_without_bias() -> None:
    zero, theirs, ours = curves(panel((0.0,) * 5))
    assert theirs == ours
    assert (ours[0], ours[-1]) == (zero[0], zero[1])


def test_positive_errors_are_drawn_above_zero_and_in_proportion() -> None:
    zero, _, ours = curves(panel((0.0, 0.005, 0.01, -0.005, 0.0)))
    rises = [zero[0][1] - y for _, y in ours]
    assert rises[1] > 0
    assert rises[2] == pytest.approx(2 * rises[1], abs=0.2)
    assert rises[3] == pytest.approx(-rises[1], abs=0.2)


def test_errors_beyond_the_range_are_drawn_at_the_edge() -> None:
    _, theirs, ours = curves(panel((0.02,) * 5, (7.0, 0.02, 0.02, -9.0, -0.02)))
    assert theirs[0][1] == theirs[1][1] == ours[0][1]
    assert theirs[3][1] == theirs[4][1]


def test_points_that_were_not_found_are_left_out() -> None:
    _, theirs, ours = curves(panel((0.0, math.nan, 0.0, 0.0, 0.0), (None, 0.0, None, 0.0, 0.0)))
    assert (len(theirs), len(ours)) == (3, 4)


def test_panels_are_stacked_without_overlap() -> None:
    upper, lower = (curves(panel((0.0,) * 5), panel((0.0,) * 5))[k][0][1] for k in (0, 3))
    assert lower > upper + 100
