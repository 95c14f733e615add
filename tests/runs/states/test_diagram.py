"""The diagrams in the documentation are those of the tables."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.runs.states.diagram import TABLES, main, mermaid, redrawn

DOCUMENT = Path(__file__).parents[3] / "docs" / "internals" / "runs.md"


def test_the_page_shows_the_tables_as_they_are() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert redrawn(text) == text, "run: python -m vaoi_station.runs.states.diagram docs/internals/runs.md"
    for table in TABLES.values():
        assert mermaid(table) in text


def test_every_step_is_drawn_once() -> None:
    for table in TABLES.values():
        arrows = [line.split(": ", 1) for line in mermaid(table).splitlines()[2:]]
        drawn = [(way.strip(), event) for way, events in arrows for event in events.split(", ")]
        assert sorted(drawn) == sorted((f"{s} --> {t}", str(e)) for (s, e), t in table.steps.items())


def test_an_old_picture_is_replaced(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- drawn: run -->\n```mermaid\nold\n```\nafter\n")
    main(page)
    assert mermaid(TABLES["run"]) in page.read_text()
    assert page.read_text().startswith("before")
    assert page.read_text().endswith("after\n")
