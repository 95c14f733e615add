from __future__ import annotations

import pytest

from vaoi_station.board_data.contours import graph as g
from vaoi_station.board_data.contours.unused import Drawing, note_on_unused

SIDES = [[(0, 0), (10, 0)], [(10, 0), (10, 10)], [(10, 10), (0, 10)], [(0, 10), (0, 0)]]


def note(*more: list[tuple[float, float]]) -> dict[str, str]:
    drawing = Drawing([*SIDES, *more])
    graph = g.graph_of(drawing.edges)
    notes = note_on_unused(drawing, graph, g.hulls(graph.faces), "$BOARD")
    return dict(notes[0].values) if notes else {}


def test_a_drawing_without_further_lines_has_no_note() -> None:
    assert note() == {}


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ([(20, 0), (30, 0)], "open"),
        ([(5, 0), (5, 10)], "dividing"),
        ([(0, 0), (10, 0)], "repeating"),
        ([(2, 0), (7, 0)], "repeating"),
        ([(10, 5), (10.01, 5)], "short"),
    ],
)
def test_every_piece_has_its_reason_and_place(line: list[tuple[float, float]], reason: str) -> None:
    values = note(line)
    assert (values["count"], values[reason], values["source"]) == ("1", "1", "$BOARD")
    assert values[f"{reason}_at"] == f"({line[0][0]:g}, {line[0][1]:g})"


def test_of_lines_that_repeat_each_other_the_longest_counts() -> None:
    assert note([(-5, 0), (15, 0)])["repeating_at"] == "(0, 0)"


def test_thousands_of_short_lines_do_not_repeat_each_other() -> None:
    fine = [[(20 + k / 200, 0.0), (20 + (k + 1) / 200, 0.0)] for k in range(2000)]
    values = note(*fine, [(30, 0), (25, 8)], [(25, 8), (20, 0)])
    assert values == {}
