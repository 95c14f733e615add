"""Figures of boards: added in parts, per hour, marks, old ones deleted, independent of the runs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.store import Store
from vaoi_station.store import figures as board_figures
from vaoi_station.store.figures import BoardFigures, BoardRow, HourRow, Span

DAY = Span("2026-01-01T00:00:00.000Z", "2026-01-02T00:00:00.000Z")


def boards_in(figures: BoardFigures, span: Span, every: int = 1) -> list[BoardRow]:
    return list(figures.boards(figures.runs(span, 1000, every)))


def hours_in(figures: BoardFigures, span: Span) -> list[HourRow]:
    return list(figures.hours(figures.hour_numbers(span)))


def row(n: int, minute: int, board_type: str = "b", **figures: float) -> BoardRow:
    return BoardRow(f"r{n}", f"2026-01-01T{minute // 60:02d}:{minute % 60:02d}:00.000Z", board_type, figures)


def test_figures_are_added_in_parts_and_counted_once(store: Store) -> None:
    figures = store.figures
    figures.add(row(1, 5, a=1.0), {})
    figures.add(row(1, 5, a=9.0, b=-7.0), {})
    figures.add(row(2, 59, a=3.0), {})
    figures.add(row(3, 61, "other", a=5.0), {}).result(10)
    assert [(r.run, dict(r.figures)) for r in boards_in(figures, DAY)] == [
        ("r1", {"a": 1.0, "b": -7.0}), ("r2", {"a": 3.0}), ("r3", {"a": 5.0}),
    ]  # fmt: skip
    first, second = hours_in(figures, DAY)
    assert (first.hour, dict(first.figures)) == (
        "2026-01-01T00",
        {"a": (2, 2.0, 1.0, 3.0, "r2"), "b": (1, -7, -7, -7, "r1")},
    )
    assert second.board_type == "other"
    assert [r.run for r in boards_in(figures, replace(DAY, board_type="other"))] == ["r3"]
    assert [r.run for r in boards_in(figures, DAY, every=2)] == ["r2"]
    assert figures.count(DAY) == 3
    assert figures.first_board() == "2026-01-01T00:05:00.000Z"
    assert hours_in(figures, replace(DAY, board_type="b")) == [first]


def test_a_change_of_what_figures_depend_on_is_marked_once(store: Store) -> None:
    figures = store.figures
    for n, calibration in enumerate("xxyyx"):
        made = {("calibration", ""): calibration, ("light", "b"): "ring"}
        figures.add(row(n, n), made).result(10)
    assert [(m.run, m.before, m.after) for m in figures.marks(DAY, 10)] == [("r2", "x", "y"), ("r4", "y", "x")]
    assert [m.run for m in figures.marks(DAY, 1)] == ["r4"]
    figures.add(row(7, 7, "c"), {("light", "c"): "ring"})
    figures.add(row(8, 8, "c"), {("light", "c"): "dome"}).result(10)
    assert [m.run for m in figures.marks(replace(DAY, board_type="b"), 10)] == ["r2", "r4"]
    assert figures.marks(replace(DAY, board_type="c"), 10)[-1].after == "dome"


def test_old_figures_are_deleted_and_the_last_marks_stay(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board_figures, "_EVERY", 10)
    monkeypatch.setattr(board_figures, "MOST_MARKS", 2)
    old = BoardRow("r", "2015-01-01T00:00:00.000Z", "b", {"a": 1.0})
    store.figures.add(old, {("light", "b"): "ring"})
    for n in range(19):
        store.figures.add(row(n, n, a=1.0), {("software", ""): str(n)}, kept=5)
    store.database.write(lambda _: None).result(10)
    assert [r.run for r in boards_in(store.figures, DAY)] == [f"r{n}" for n in range(14, 19)]
    (hour,) = hours_in(store.figures, Span("2000-01-01T00:00:00.000Z", DAY.until))
    assert hour.figures["a"][0] == 19
    assert [m.after for m in store.figures.marks(DAY, 10)] == ["17", "18"]
    store.figures.add(row(20, 20), {("light", "b"): "dome"}).result(10)
    assert store.figures.marks(DAY, 10)[-1].before == "ring"


def test_a_damaged_row_does_not_keep_figures_from_being_added(store: Store) -> None:
    store.figures.add(row(1, 1, a=1.0), {}).result(10)
    store.database.write(lambda c: c.execute("UPDATE board_figures SET document = '{'")).result(10)
    store.database.write(lambda c: c.execute("UPDATE hourly_figures SET document = '{'")).result(10)
    assert boards_in(store.figures, DAY)[0].figures == {}
    store.figures.add(row(2, 2, a=3.0), {}).result(10)
    assert hours_in(store.figures, DAY)[0].figures == {"a": (1, 3.0, 3.0, 3.0, "r2")}
