from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration.artwork import Board, render_svg

Shapes = list[NDArray[Any]]
Numbers = Callable[[str], list[float]]
Check = Callable[[Shapes, tuple[float, float]], None]
TITLE = "three <cameras> (33 mm) & \\ more"


def _read_svg(document: str, numbers: Numbers) -> tuple[Shapes, Shapes, tuple[float, ...]]:
    """Marks and strokes in user units, and the size of the page in mm."""
    root, name = ElementTree.fromstring(document), "{http://www.w3.org/2000/svg}"
    groups = {g.get("id"): g for g in root.iter(f"{name}g")}

    def paths(group: str) -> Shapes:
        return [np.array(numbers(str(p.get("d")))).reshape(-1, 2) for p in groups[group].iter(f"{name}path")]

    size = tuple(float(str(root.get(k)).removesuffix("mm")) for k in ("width", "height"))
    view = numbers(str(root.get("viewBox")))
    assert view[2:] == pytest.approx(size)  # one user unit is one mm
    return paths("marks"), paths("scale"), size


def test_marks_scale_bar_and_page_are_those_of_the_board(board: Board, numbers: Numbers, check_marks: Check) -> None:
    marks, strokes, size = _read_svg(render_svg(board, TITLE), numbers)
    check_marks(marks, (0, 0))
    assert size == pytest.approx(board.size_mm)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0, abs=1e-6)
    assert min(s[:, 1].min() for s in strokes) > 13.0, "below the lower edge of the views"
