"""Reading of printed codes and of codes of dots, as `vaoi bench --codes` measures it."""

from __future__ import annotations

from vaoi_station.benchmarks.codes import (
    measure_code_reading,
    measure_dotted_codes,
)


def test_large_codes_are_read_and_tiny_ones_counted_as_unread() -> None:
    lines: list[str] = []
    tiny, large = measure_code_reading(3, (1.2, 5.0), lines.append)
    assert (large.views, large.read, large.wrong) == (3, 3, 0)
    assert (tiny.read, tiny.wrong) == (0, 0)
    assert "module  5.0 px: 3 of 3 read (100.0 %), 0 wrong" in lines[1]


def test_drawings_of_either_polarity_are_read_disturbed_or_not() -> None:
    lines: list[str] = []
    rates = measure_dotted_codes(2, dots=(0.85,), modules_px=(6.0,), report=lines.append)
    assert [(r.inverted, r.disturbed) for r in rates] == [(False, False), (True, False), (False, True), (True, True)]
    assert sum(r.read for r in rates[:2]) == 4
    assert sum(r.wrong for r in rates) == 0
    assert lines[1].startswith("light dots of 0.85 modules of  6.0 px: 2 of 2 read (34.2 to 100.0 %), 0 wrong")
    assert rates[0].share == (0.3424, 1.0)
