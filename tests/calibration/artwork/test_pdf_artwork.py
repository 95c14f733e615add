from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration.artwork import ArrayDesign, Board, design_board, render_pdf
from vaoi_station.errors import InputError

Shapes = list[NDArray[Any]]
Numbers = Callable[[str], list[float]]
Check = Callable[[Shapes, tuple[float, float]], None]
TITLE = "three <cameras> (33 mm) & \\ more"


def _read_pdf(document: bytes, numbers: Numbers) -> tuple[Shapes, Shapes, tuple[float, ...]]:
    """Marks and strokes in mm of the page, y down, and the size of the page; checks the cross-reference table too."""
    begin = int(re.findall(rb"startxref\s+(\d+)", document)[-1])
    assert document[begin : begin + 4] == b"xref"
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", document), start=1):
        assert document[int(offset) :].startswith(b"%d 0 obj" % number)
    box = [float(v) for v in re.findall(rb"/MediaBox \[([^\]]*)\]", document)[0].split()]
    length = int(re.findall(rb"/Length (\d+)", document)[0])
    content = document[document.index(b"stream\n") + 7 :][:length].decode("latin-1")
    assert document[document.index(b"stream\n") + 7 + length :].startswith(b"\nendstream")
    a, b, c, d, e, f = numbers(next(line for line in content.split("\n") if line.endswith(" cm")))
    assert (b, c) == (0, 0)

    def on_page(points: NDArray[Any]) -> NDArray[Any]:
        x, y = points[:, 0] * a + e, points[:, 1] * d + f
        return np.stack([x, box[3] - y], 1) * 25.4 / 72

    filled = [ln for ln in content.split("\n") if ln.endswith(" h f")]
    stroked = [ln for ln in content.split("\n") if ln.endswith(" l S")]
    shapes = [[on_page(np.array(numbers(ln)).reshape(-1, 2)) for ln in lines] for lines in (filled, stroked)]
    return shapes[0], shapes[1], (box[2] * 25.4 / 72, box[3] * 25.4 / 72)


def test_marks_scale_bar_and_page_are_those_of_the_board(board: Board, numbers: Numbers, check_marks: Check) -> None:
    marks, strokes, size = _read_pdf(render_pdf(board, TITLE), numbers)
    check_marks(marks, board.low_mm)
    assert size == pytest.approx(board.size_mm, abs=1e-3)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0, abs=1e-3)
    assert min(s[:, 1].min() for s in strokes) + board.low_mm[1] > 13.0, "below the lower edge of the views"


def test_a_board_larger_than_a_page_is_refused() -> None:
    with pytest.raises(InputError, match="at most 5080 mm"):
        render_pdf(design_board(ArrayDesign(60, 100.0, (110.0, 80.0))), "")
