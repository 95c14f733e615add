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
    round_down,
    round_up,
    table,
    tag,
    text,
)
from vaoi_station.reporting.stitched_run import thumbnail

texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S")), min_size=1)


@given(texts, texts)
def test_texts_and_attributes_come_back_as_they_were(words: str, name: str) -> None:
    element = ET.fromstring(tag("a", text(words), title=name, data_k=1))
    assert (element.text or "") == words
    assert element.attrib == {"title": name, "data-k": "1"}


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
