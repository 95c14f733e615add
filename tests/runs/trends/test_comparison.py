"""Two spans: what changed by more than its spread comes first; chance is no change."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.runs.trends.comparison import compare
from vaoi_station.store.history.board_figures import BoardRow


def boards(count: int, seed: int, **means: float) -> list[BoardRow]:
    random = np.random.default_rng(seed)
    columns = {name: mean + 0.1 * abs(mean) * random.standard_normal(count) for name, mean in means.items()}
    return [BoardRow(f"r{n}", "", "b", {k: float(v[n]) for k, v in columns.items()}) for n in range(count)]


def test_the_largest_change_in_spreads_comes_first() -> None:
    found = compare(
        boards(50, 1, residual_px=1, seam_px=1, ready_ms=10, belt_mm_s=100),
        boards(50, 2, residual_px=1.3, seam_px=2, ready_ms=10, belt_mm_s=50),
    )
    assert [c.figure for c in found] == ["seam_px", "belt_mm_s", "residual_px", "ready_ms"]
    assert [c.changed for c in found] == [True, True, True, False]
    assert [c.worse for c in found[:3]] == [True, None, True]
    assert found[0].change == pytest.approx(1, abs=0.1)
    assert found[0].before.spread == pytest.approx(0.1, rel=0.4)


def test_few_boards_show_no_small_change() -> None:
    (found,) = compare(boards(6, 1, sigma_px=1), boards(6, 2, sigma_px=1.05))
    assert not found.changed
    assert compare(boards(4, 1, sigma_px=1), boards(9, 2, sigma_px=9)) == ()


def test_counts_are_compared_by_their_means() -> None:
    def lost(share: int) -> list[BoardRow]:
        return [BoardRow(f"r{n}", "", "b", {"lost_frames": float(n % share == 0)}) for n in range(400)]

    (found,) = compare(lost(100), lost(4))
    assert found.changed
    assert (found.before.middle, found.now.middle) == (0.01, 0.25)
    assert not compare(lost(100), lost(90))[0].changed


def test_a_figure_without_spread_that_jumps_has_changed() -> None:
    one, other = ([BoardRow(f"r{n}", "", "b", {"ready_ms": ms}) for n in range(5)] for ms in (80.0, 90.0))
    assert compare(one, other)[0].changed
    assert not compare(one, one)[0].changed
