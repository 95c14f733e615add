"""Texts are escaped and drawings are well-formed."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.reporting.drawing.svg import drawing, label, polygon, polyline, shown, tag, text

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
