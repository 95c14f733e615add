"""Bins of time: their width, their mean, least and largest values, and the board that stands out."""

from __future__ import annotations

import pytest

from vaoi_station.runs.trends.thinning import (
    bin_width_s,
    groups_of_boards,
    groups_of_hours,
    series_of_groups,
    single_boards,
)
from vaoi_station.store.history.board_figures import BoardRow, HourRow, Span


@pytest.mark.parametrize(
    ("days", "points", "least_s", "width_s"),
    [(1, 600, 0, 300), (1, 600, 3600, 3600), (28, 600, 0, 7200), (31, 10, 0, 7 * 86400), (3000, 10, 0, 7 * 86400)],
)
def test_a_width_is_chosen_by_the_number_of_points(days: int, points: int, least_s: float, width_s: float) -> None:
    last = {1: "2026-01-02", 28: "2026-01-29", 31: "2026-02-01", 3000: "2034-03-20"}[days]
    span = Span("2026-01-01T00:00:00.000Z", f"{last}T00:00:00.000Z")
    assert bin_width_s(span, points, least_s) == width_s


def test_a_bin_has_the_extremes_of_its_boards_and_names_one() -> None:
    rows = [
        BoardRow(f"r{n}", f"2026-01-01T00:{n:02d}:30.000Z", "b", {"seam_px:0-1": float(n % 3), "unknown": 1.0})
        for n in range(7)
    ]
    groups = groups_of_boards(rows, 300)
    assert [(g.time, g.boards) for g in groups] == [("2026-01-01T00:00:00.000Z", 5), ("2026-01-01T00:05:00.000Z", 2)]
    (series,) = series_of_groups(groups, ())
    assert (series.figure, series.part, series.upper) == ("seam_px", "0-1", 0.3)
    assert (series.values, series.least, series.largest) == ((0.8, 1.0), (0.0, 0.0), (2.0, 2.0))
    assert series.runs == ("r2", "r5")
    assert series_of_groups(groups, ["ready_ms"]) == []


def test_a_figure_that_a_board_lacks_is_left_out() -> None:
    rows = [BoardRow("r1", "", "b", {"ready_ms": 1.0}), BoardRow("r2", "", "b", {"sigma_px": 0.1})]
    boards = single_boards(iter(rows), ())
    assert (boards.runs, boards.times) == (("r1", "r2"), ("", ""))
    sigma, ready = boards.series
    assert (sigma.figure, sigma.at, sigma.values) == ("sigma_px", (1,), (0.1,))
    assert (ready.at, ready.values) == ((0,), (1.0,))


def test_hours_of_all_types_are_joined() -> None:
    one = {"lost_frames": (2, 1.0, 0.0, 2.0, "r1")}
    rows = [HourRow("2026-01-01T04", name, one) for name in ("a", "b")]
    (group,) = groups_of_hours(rows, 86400)
    assert (group.time, group.boards) == ("2026-01-01T00:00:00.000Z", 4)
