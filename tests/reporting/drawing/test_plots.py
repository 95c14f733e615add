"""Curves over rows with their uncertainty."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.reporting.drawing.plots import Plot

PLOT = Plot("along", "µm", 400.0)
values = st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=20)


def circles(svg: str) -> list[ET.Element]:
    """Return the points of a drawing."""
    return list(ET.fromstring(svg).iter("circle"))


@given(values)
def test_every_row_is_a_point_inside_the_drawing(given_values: list[float]) -> None:
    value = np.array(given_values)
    points = circles(PLOT.draw(value, np.ones(len(value)), [True] * len(value)))
    assert len(points) == len(value)
    for point in points:
        assert 0 <= float(point.attrib["cx"]) <= PLOT.width
        assert 0 <= float(point.attrib["cy"]) <= PLOT.height


def test_larger_values_are_higher_and_later_rows_further_right() -> None:
    first, second = circles(PLOT.draw(np.array([0.0, 5.0]), np.zeros(2), [True, True]))
    assert float(second.attrib["cy"]) < float(first.attrib["cy"])
    assert float(second.attrib["cx"]) > float(first.attrib["cx"])


def test_rows_without_evidence_are_hollow_and_do_not_set_the_scale() -> None:
    value, sigma = np.array([0.0, 1.0, 2.0]), np.array([0.1, 0.1, 1e6])
    svg = PLOT.draw(value, sigma, [True, True, False])
    assert [p.attrib["fill"] for p in circles(svg)] == ["#22456b", "#22456b", "#fff"]
    heights = [float(p.attrib["cy"]) for p in circles(svg)]
    assert max(heights) - min(heights) > PLOT.height / 2
    assert "placed by the nominal motion alone" in svg


@pytest.mark.parametrize(("rows", "points"), [(200, 200), (201, 0)])
def test_many_rows_are_drawn_without_points(rows: int, points: int) -> None:
    assert len(circles(PLOT.draw(np.zeros(rows), np.ones(rows), [False] * rows))) == points
