from __future__ import annotations

from vaoi_station.benchmarks.pull import FRACTIONS, measure_pull


def test_whole_pixels_pull_at_links_by_next_to_nothing() -> None:
    figures = measure_pull(noises=(0.0,))
    assert [p.axis for p in figures.pulls] == ["x", "y"]
    for pull in figures.pulls:
        assert pull.fraction == FRACTIONS
        assert pull.largest_px <= 0.005
        assert max(abs(e) for e in pull.lucas_kanade_px) > 2 * pull.largest_px
    assert "plain Lucas-Kanade" in next(figures.lines())
    assert figures.plot().count("<polyline") == 6
