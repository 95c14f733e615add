"""HTML and SVG."""

from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.reporting.drawing import (
    POLICY,
    Scale,
    Section,
    number,
    page,
    plot,
    round_down,
    round_up,
    shown,
    table,
    tag,
    text,
)
from vaoi_station.reporting.stitched_run import NARROWEST_PX, WIDEST_PX, thumbnail, thumbnail_width

texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S")), min_size=1)


@given(texts, texts)
def test_texts_and_attributes_come_back_as_they_were(words: str, name: str) -> None:
    element = ET.fromstring(tag("a", text(words), title=name, data_k=1))
    assert (element.text or "") == words
    assert element.attrib == {"title": name, "data-k": "1"}


def test_numbers_are_short_and_finite() -> None:
    assert [shown(v) for v in (1.0, 0.126, -3.5, float("nan"), 7, "x")] == ["1", "0.13", "-3.5", "0", "7", "x"]


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


@given(st.lists(st.lists(texts, min_size=2, max_size=2), max_size=4))
def test_table_keeps_every_text(rows: list[list[str]]) -> None:
    root = ET.fromstring(table(["name", "value"], rows, 1))
    assert [[cell.text for cell in row] for row in root.iter("tr")][1:] == rows
    assert [cell.get("class") for cell in root.iter("th")] == [None, "n"]


sizes = st.floats(1e-9, 1e9)


@given(sizes)
def test_round_numbers_enclose(value: float) -> None:
    low, high = round_down(value), round_up(value)
    assert low <= value * (1 + 1e-9)
    assert value <= high * (1 + 1e-9)
    assert high / low <= 2.5 + 1e-9
    for found in (low, high):
        digit = found / 10 ** math.floor(math.log10(found) + 1e-9)
        assert digit == pytest.approx(1) or digit == pytest.approx(2) or digit == pytest.approx(5)


def test_colours_at_the_ends() -> None:
    scale = Scale(0, 10, ((0, 0, 0), (100, 200, 50)))
    assert [scale(v) for v in (-5, 0, 5, 10, 99)] == ["#000000", "#000000", "#326419", "#64c832", "#64c832"]
    assert len(Scale(3, 3)(3)) == 7, "all values are equal"


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(None, 3, "–"), (float("nan"), 3, "–"), (-0.5, 2, "−0.50"), (-1e-9, 3, "0.000"), (12.0, 0, "12"), (0.0, 1, "0.0")],
)
def test_numbers_as_text(value: float | None, digits: int, written: str) -> None:
    assert number(value, digits) == written


def test_every_row_is_a_point_and_those_without_evidence_do_not_set_the_scale() -> None:
    value, sigma = np.array([0.0, 1.0, 2.0]), np.array([0.1, 0.1, 1e6])
    svg = plot("along", "µm", 400.0, value, sigma, np.array([True, True, False]))
    points = [p.attrib for p in ET.fromstring(svg).iter("circle")]
    assert [p["fill"] for p in points] == ["#22456b", "#22456b", "#fff"]
    x, y = ([float(p[key]) for p in points] for key in ("cx", "cy"))
    assert 0 <= x[0] < x[1] < x[2] <= 400
    assert 190 >= y[0] > y[1] > y[2] + 50 > 50
    assert "placed by the nominal motion alone" in svg
    assert "<circle" not in plot("along", "µm", 400.0, np.zeros(201), np.ones(201), np.zeros(201, dtype=bool))


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
