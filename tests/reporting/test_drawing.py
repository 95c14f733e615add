"""HTML and SVG."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.reporting.drawing import (
    NARROWEST_PX,
    POLICY,
    WIDEST_PX,
    Plot,
    Scale,
    Section,
    about_zero,
    drawing,
    facts,
    figures,
    folded,
    label,
    number,
    page,
    polygon,
    polyline,
    round_down,
    round_up,
    shown,
    table,
    tag,
    text,
    thumbnail,
    thumbnail_width,
    ticks,
)

printable = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")))


@given(printable, printable)
def test_texts_and_attributes_come_back_as_they_were(words: str, name: str) -> None:
    element = ET.fromstring(tag("a", text(words), title=name, data_k=1))
    assert (element.text or "") == words
    assert element.attrib == {"title": name, "data-k": "1"}


def test_a_drawing_is_well_formed() -> None:
    parts = (label(1, 2, "a < b"), polyline([(0, 0), (1.234, 5)], stroke="#000"), polygon([(0, 0), (1, 1), (0, 1)]))
    root = ET.fromstring(drawing(10, 20.5, *parts, label="what & why"))
    assert root.attrib["viewBox"] == "0 0 10 20.5"
    assert [e.tag for e in root] == ["title", "text", "polyline", "polygon"]
    assert root[2].attrib["points"] == "0,0 1.23,5"


def test_numbers_are_short_and_finite() -> None:
    assert [shown(v) for v in (1.0, 0.126, -3.5, float("nan"), 7, "x")] == ["1", "0.13", "-3.5", "0", "7", "x"]


texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S")), min_size=1)


def test_page_holds_title_contents_and_sections_in_order() -> None:
    sections = [Section("one", "First", "", "<p>1</p>"), Section("two", "Second & last", "Read <this>.", "<p>2</p>")]
    text = page("a < b", "<h1>head</h1>", sections, "<!--data-->")
    assert "<title>a &lt; b</title>" in text
    assert f'content="{POLICY}"' in text
    assert '<a href="#one">First</a><a href="#two">Second &amp; last</a>' in text
    positions = [
        text.index(part) for part in ("<h1>head", "<nav>", "<p>1</p>", "Read &lt;this&gt;.", "<p>2</p>", "<!--d")
    ]
    assert positions == sorted(positions)
    assert "<style>" in text


def test_section_without_a_lead_has_no_empty_paragraph() -> None:
    assert Section("one", "First", "", "body").html() == '<section id="one"><h2>First</h2>body</section>'


@given(st.lists(st.lists(texts, min_size=2, max_size=2), max_size=4))
def test_table_keeps_every_text(rows: list[list[str]]) -> None:
    root = ET.fromstring(table(["name", "value"], rows, 1))
    assert [[cell.text for cell in row] for row in root.iter("tr")][1:] == rows
    assert [cell.get("class") for cell in root.iter("th")] == [None, "n"]


def test_table_without_numbers() -> None:
    assert 'class="n"' not in table(["a", "b"], [["1", "2"]])


def test_facts_figures_and_folded_content() -> None:
    assert facts([("a", "1 < 2")]) == "<dl><dt>a</dt><dd>1 &lt; 2</dd></dl>"
    assert figures(("<svg/>", "drawn"), ("", "left out")).count("<figure>") == 1
    assert folded("more & more", "<p/>") == "<details><summary>more &amp; more</summary><p/></details>"


sizes = st.floats(1e-9, 1e9)
finite = st.floats(-1e6, 1e6)


@given(sizes)
def test_round_numbers_enclose(value: float) -> None:
    low, high = round_down(value), round_up(value)
    assert low <= value * (1 + 1e-9)
    assert value <= high * (1 + 1e-9)
    assert high / low <= 2.5 + 1e-9
    for found in (low, high):
        digit = found / 10 ** math.floor(math.log10(found) + 1e-9)
        assert digit == pytest.approx(1) or digit == pytest.approx(2) or digit == pytest.approx(5)


@given(finite, sizes.filter(lambda v: 1e-3 < v < 1e6))
def test_ticks_are_evenly_spaced_and_inside(low: float, span: float) -> None:
    found = ticks(low, low + span)
    assert 1 <= len(found) <= 8
    assert all(low - 1e-6 * span <= t <= low + span * (1 + 1e-6) for t in found)
    steps = {round((b - a) / span, 5) for a, b in pairwise(found)}
    assert len(steps) <= 1


@given(finite, st.lists(finite, max_size=5))
def test_every_number_has_a_colour(value: float, others: list[float]) -> None:
    for scale in (Scale(0, 1), Scale(3, 3), about_zero(others, 0.02)):
        colour = scale(value)
        assert len(colour) == 7
        int(colour[1:], 16)


def test_colours_at_the_ends() -> None:
    scale = Scale(0, 10, ((0, 0, 0), (100, 200, 50)))
    assert [scale(v) for v in (-5, 0, 5, 10, 99)] == ["#000000", "#000000", "#326419", "#64c832", "#64c832"]


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(None, 3, "–"), (float("nan"), 3, "–"), (-0.5, 2, "−0.50"), (-1e-9, 3, "0.000"), (12.0, 0, "12"), (0.0, 1, "0.0")],
)
def test_numbers_as_text(value: float | None, digits: int, written: str) -> None:
    assert number(value, digits) == written


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


def decoded(jpeg: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colour", [False, True])
def test_any_frame_becomes_a_small_grey_picture(dtype: type, colour: bool) -> None:
    ramp: NDArray[Any] = np.tile(np.linspace(0, 255 if dtype is np.uint8 else 65535, 640), (480, 1)).astype(dtype)
    small = thumbnail(np.dstack([ramp] * 3) if colour else ramp, 100)
    assert (small.width, small.height) == (100, 75)
    seen = decoded(small.jpeg)
    assert seen.shape == (75, 100)
    assert seen[40, 95] > 200 > seen[40, 5]
    assert small.uri.startswith("data:image/jpeg;base64,/9j/")


def test_dark_frames_are_brightened_and_small_ones_not_enlarged() -> None:
    dark = np.full((30, 40), 12, np.uint8)
    dark[10:20, 10:20] = 50
    small = thumbnail(dark, 100)
    assert (small.width, small.height) == (40, 30)
    assert decoded(small.jpeg)[15, 15] > 200


def test_many_frames_have_small_thumbnails() -> None:
    widths = [thumbnail_width(n) for n in (0, 1, 100, 420, 5000, 10**6)]
    assert widths[0] == WIDEST_PX
    assert widths[-1] == NARROWEST_PX
    assert widths == sorted(widths, reverse=True)
