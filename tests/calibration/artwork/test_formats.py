"""Each format is read back by a small reader of its own, and marks must be within a micron of the layout."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration.artwork import (
    ArrayDesign,
    Board,
    design_board,
    render_gerber_marks,
    render_gerber_outline,
    render_pdf,
    render_svg,
)
from vaoi_station.errors import InputError
from vaoi_station.files.layouts import read_layout

Shapes = list[NDArray[Any]]
TITLE = "three <cameras> (33 mm) & \\ more"
EXAMPLE = Path(__file__).parents[3] / "hw" / "calibration-board"


@pytest.fixture(scope="module")
def board() -> Board:
    return design_board(ArrayDesign(3, 33.143, (34.8, 26.0)))


def _numbers(text: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def _read_svg(document: str) -> tuple[Shapes, Shapes, tuple[float, ...]]:
    """Marks and strokes in user units, and the size of the page in mm."""
    root, name = ElementTree.fromstring(document), "{http://www.w3.org/2000/svg}"
    groups = {g.get("id"): g for g in root.iter(f"{name}g")}

    def paths(group: str) -> Shapes:
        return [np.array(_numbers(str(p.get("d")))).reshape(-1, 2) for p in groups[group].iter(f"{name}path")]

    size = tuple(float(str(root.get(k)).removesuffix("mm")) for k in ("width", "height"))
    view = _numbers(str(root.get("viewBox")))
    assert view[2:] == pytest.approx(size)  # one user unit is one mm
    return paths("marks"), paths("scale"), size


def _read_pdf(document: bytes) -> tuple[Shapes, Shapes, tuple[float, ...]]:
    """The same in mm of the page, x right and y down from its upper left corner; the file's own table is followed."""
    begin = int(re.findall(rb"startxref\s+(\d+)", document)[-1])
    assert document[begin : begin + 4] == b"xref"
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", document), start=1):
        assert document[int(offset) :].startswith(b"%d 0 obj" % number)
    box = [float(v) for v in re.findall(rb"/MediaBox \[([^\]]*)\]", document)[0].split()]
    length = int(re.findall(rb"/Length (\d+)", document)[0])
    content = document[document.index(b"stream\n") + 7 :][:length].decode("latin-1")
    assert document[document.index(b"stream\n") + 7 + length :].startswith(b"\nendstream")
    a, b, c, d, e, f = _numbers(next(line for line in content.split("\n") if line.endswith(" cm")))
    assert (b, c) == (0, 0)

    def on_page(points: NDArray[Any]) -> NDArray[Any]:
        x, y = points[:, 0] * a + e, points[:, 1] * d + f
        return np.stack([x, box[3] - y], 1) * 25.4 / 72

    filled = [ln for ln in content.split("\n") if ln.endswith(" h f")]
    stroked = [ln for ln in content.split("\n") if ln.endswith(" l S")]
    shapes = [[on_page(np.array(_numbers(ln)).reshape(-1, 2)) for ln in lines] for lines in (filled, stroked)]
    return shapes[0], shapes[1], (box[2] * 25.4 / 72, box[3] * 25.4 / 72)


def _read_gerber(document: str) -> tuple[NDArray[Any], tuple[float, float], Shapes]:
    """Flashes (k, 2) in mm, the aperture's size and width, and the strokes drawn."""
    assert "%FSLAX46Y46*%" in document
    assert "%MOMM*%" in document
    assert document.rstrip().endswith("M02*")
    size, width = (float(v) for v in re.findall(r"%ADD10CROSS,([\d.]+)X([\d.]+)\*%", document)[0])
    flashes, strokes, at = [], [], np.zeros(2)
    for x, y, code in re.findall(r"X(-?\d+)Y(-?\d+)D0([123])\*", document):
        to = np.array([int(x), int(y)]) / 1e6
        if code == "3":
            flashes.append(to)
        elif code == "1":
            strokes.append(np.array([at, to]))
        at = to
    return np.array(flashes), (size, width), strokes


def _is_cross(corners: NDArray[Any], size: float, width: float) -> bool:
    q = np.abs(corners - corners.mean(0))
    return (
        len(q) == 12
        and np.allclose(np.sort(q, axis=1).min(0), (width / 2, width / 2), atol=1e-4)
        and bool(np.allclose(q.max(0), size / 2, atol=1e-4))
    )


def _check(board: Board, marks: Shapes, origin: tuple[float, float]) -> None:
    centers = np.array([m.mean(0) for m in marks])
    assert len(centers) == len(board.places_mm)
    assert np.abs(centers - (board.places_mm - origin)).max() < 1e-3
    assert all(_is_cross(m, 2.0, 0.5) for m in marks)


def test_svg_shows_the_layout(board: Board) -> None:
    marks, strokes, size = _read_svg(render_svg(board, TITLE))
    _check(board, marks, (0, 0))
    assert size == pytest.approx(board.size_mm)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0, abs=1e-6)
    assert "three &lt;cameras&gt;" in render_svg(board, TITLE)


def test_pdf_prints_the_layout_one_to_one(board: Board) -> None:
    document = render_pdf(board, TITLE)
    marks, strokes, size = _read_pdf(document)
    _check(board, marks, board.low_mm)
    assert size == pytest.approx(board.size_mm, abs=1e-3)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0, abs=1e-3)
    assert b"/PrintScaling /None" in document
    assert rb"three <cameras> \(33 mm\) & \\ more" in document


def test_gerber_flashes_the_layout_with_y_up(board: Board) -> None:
    flashes, aperture, strokes = _read_gerber(render_gerber_marks(board))
    assert np.abs(flashes - board.places_mm * (1, -1)).max() < 1e-3
    assert aperture == (2.0, 0.5)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0)
    outline = np.array(
        [[int(v) / 1e6 for v in xy] for xy in re.findall(r"X(-?\d+)Y(-?\d+)D01", render_gerber_outline(board))]
    )
    assert np.ptp(outline, axis=0) == pytest.approx(board.size_mm)


def test_light_marks_stand_on_dark_ground() -> None:
    board = design_board(ArrayDesign(1, 30.0, (34.8, 26.0), polarity="light"))
    assert 'fill="#000000"/>' in render_svg(board, "")
    assert b"\n0 g " in render_pdf(board, "")
    assert board.layout.mark.polarity == "light"


@pytest.mark.parametrize("read", [lambda b: render_svg(b, ""), lambda b: render_pdf(b, "")])
def test_the_scale_bar_keeps_off_the_views(board: Board, read: Callable[[Board], Any]) -> None:
    content = read(board)
    strokes = (_read_svg(content) if isinstance(content, str) else _read_pdf(content))[1]
    top = min(s[:, 1].min() for s in strokes) + (0 if isinstance(content, str) else board.low_mm[1])
    assert top > 13.0  # lower edge of the views


def test_a_board_too_long_for_a_page_is_refused() -> None:
    with pytest.raises(InputError, match="at most 5080 mm"):
        render_pdf(design_board(ArrayDesign(60, 100.0, (110.0, 80.0))), "")


def test_the_example_is_what_the_software_makes_now(board: Board) -> None:
    assert read_layout(EXAMPLE / "layout.json") == board.layout
    assert (EXAMPLE / "calibration-board.gbr").read_text() == render_gerber_marks(board)
    assert (EXAMPLE / "calibration-board-outline.gbr").read_text() == render_gerber_outline(board)
    _check(board, _read_svg((EXAMPLE / "calibration-board.svg").read_text())[0], (0, 0))
    _check(board, _read_pdf((EXAMPLE / "calibration-board.pdf").read_bytes())[0], board.low_mm)
