"""The frame of the report: sections, tables, and a policy that forbids requests and scripts."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.reporting.drawing.html_page import POLICY, Section, facts, figures, folded, page, table

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
