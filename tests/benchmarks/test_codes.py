"""Reading of printed codes and of codes of dots, as `vaoi bench --codes` measures it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.benchmarks.codes import (
    DottedCode,
    draw_dotted_code,
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


def test_dots_cover_their_share_of_a_code_and_stay_within_its_corners() -> None:
    code = DottedCode(dot=1.0, noise=0.0, blur_px=0.3, grey=(0.0, 200.0), module_px=8.0)
    shown, corners = draw_dotted_code(code)
    small, _ = draw_dotted_code(replace(code, dot=0.7))
    dark, dark_of_small = (200.0 * p.size - p.sum() for p in (shown, small))
    assert dark_of_small / dark == pytest.approx(0.49, abs=0.02)
    y, x = np.nonzero(shown < 100)
    assert (x.min(), x.max()) == pytest.approx((corners[0, 0] + 0.5, corners[1, 0] - 0.5), abs=1.5)
    assert (y.min(), y.max()) == pytest.approx((corners[0, 1] + 0.5, corners[2, 1] - 0.5), abs=1.5)
