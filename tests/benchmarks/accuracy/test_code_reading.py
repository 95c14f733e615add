"""The benchmark of printed codes reads what is large enough, and counts what it cannot read."""

from __future__ import annotations

from vaoi_station.benchmarks.accuracy.code_reading import document, measure_code_reading


def test_large_codes_are_read_and_tiny_ones_counted_as_unread() -> None:
    lines: list[str] = []
    tiny, large = measure_code_reading(3, (1.2, 5.0), lines.append)
    assert (large.views, large.read, large.wrong) == (3, 3, 0)
    assert (tiny.read, tiny.wrong) == (0, 0)
    assert "module  5.0 px: 3 of 3 read (100.0 %), 0 wrong" in lines[1]
    assert document([large])["modules"][0]["read"] == 3
