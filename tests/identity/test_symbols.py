"""Codes in pictures: text, kind, corners, modules and error correction, of both polarities and of little contrast."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.identity.dotted_codes import DottedCode, draw_dotted_code
from vaoi_station.identity.symbols import read_symbols
from vaoi_station.model.board_identity import Symbology
from vaoi_station.simulation.board.printed_code import symbol

TEXT = "board;SN-0001"


def picture(symbology: str, module_px: int, *, low: int = 0, high: int = 255) -> NDArray[np.uint8]:
    dark = np.pad(symbol(symbology, TEXT), 4)
    levels = np.where(dark, low, high).astype(np.uint8)
    return np.asarray(cv2.resize(levels, None, fx=module_px, fy=module_px, interpolation=cv2.INTER_NEAREST), np.uint8)


@pytest.mark.parametrize("symbology", ["datamatrix", "qr"])
@pytest.mark.parametrize("enlarged", [1, 2])
def test_code_has_its_text_place_and_module(symbology: Any, enlarged: int) -> None:
    shown = picture(symbology, 6)
    [found] = read_symbols(shown, None, enlarged=enlarged)
    assert (found.text, found.symbology, found.error_correction_used) == (TEXT, symbology, 0.0)
    assert found.corners_px.mean(0) == pytest.approx((np.array(shown.shape) - 1) / 2, abs=0.6)
    assert found.module_px == pytest.approx(6.0, rel=0.03)
    other: Symbology = "qr" if symbology == "datamatrix" else "datamatrix"
    assert read_symbols(shown, other, enlarged=enlarged) == []


def test_damaged_modules_use_up_error_correction() -> None:
    shown = picture("datamatrix", 6)
    spoilt = shown.copy()
    spoilt[48:66, 48:66] = 255 - spoilt[48:66, 48:66]
    [found] = read_symbols(spoilt, "datamatrix")
    assert found.text == TEXT
    assert 0.1 < found.error_correction_used < 1
    spoilt[42:96, 42:96] = 255 - shown[42:96, 42:96]
    assert read_symbols(spoilt, "datamatrix") == []


def test_small_code_with_a_damaged_word_is_not_proven() -> None:
    dark = np.pad(symbol("datamatrix", "SN7"), 4)
    shown = np.where(np.kron(dark, np.ones((8, 8))) > 0, 0, 255).astype(np.uint8)
    assert [found.proven for found in read_symbols(shown, None)] == [True]
    shown[56:64, 56:64] = 255 - shown[56:64, 56:64]
    assert [(found.text, found.proven) for found in read_symbols(shown, None)] == [("SN7", False)]


DISTURBED: dict[str, dict[str, Any]] = {
    "light dots": {"dot": 0.75, "inverted": True},
    "small modules": {"module_px": 4.0, "dot": 0.7, "inverted": True, "blur_px": 0.5},
    "10 x 10": {"version": 1, "text": "123456", "dot": 0.7, "module_px": 8.0},
    "8 x 32": {"version": 26, "text": "12345678", "dot": 0.7, "turned_deg": 285.0},
    "dots of other sizes and places": {"size_spread": 0.12, "displaced": 0.1, "version": 6},
    "missing dots": {"missing": 0.04, "version": 6, "seed": 3},
    "oblique view": {"oblique": 0.08, "version": 6, "turned_deg": 30.0, "dot": 0.7},
    "brushed ground": {"brushed": 12.0, "dot": 0.75},
    "shaded": {"shaded": 60.0, "dot": 0.7, "module_px": 7.0},
    "parts": {"parts": 40, "dot": 0.8, "seed": 2},
    "dark label": {"label": 1.5, "inverted": True, "dot": 0.8},
}


def array_of_dots(rows: int, columns: int, pitch: float, hole: int = 0) -> NDArray[np.uint8]:
    """Draw a full array of dots, as balls or vias are arranged, with a hole in its middle."""
    y, x = np.mgrid[: int(pitch * (rows + 6)), : int(pitch * (columns + 6))] / pitch - 3
    row, column = np.floor(y), np.floor(x)
    there = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    there &= np.maximum(abs(row - rows // 2), abs(column - columns // 2)) >= hole
    dots = there & (np.hypot(y % 1 - 0.5, x % 1 - 0.5) < 0.4)
    noise = np.random.default_rng(rows).normal(0, 3, dots.shape)
    return np.asarray(np.clip(np.where(dots, 180, 60) + noise, 0, 255), np.uint8)


@pytest.mark.parametrize("kind", DISTURBED)
def test_code_of_dots_is_read_with_its_corners_to_a_pixel(kind: str) -> None:
    code = DottedCode(**{"turned_deg": 77.0, "seed": 1, **DISTURBED[kind]})
    picture, corners = draw_dotted_code(code)
    assert read_symbols(picture, None, dotted=False) == []
    [found] = read_symbols(picture, None)
    assert (found.text, found.symbology) == (code.text, "datamatrix")
    assert np.hypot(*(found.corners_px - corners).T).max() < 1.0
    assert found.module_px == pytest.approx(code.module_px, rel=0.02)


@pytest.mark.parametrize("size", [(10, 10), (16, 16), (26, 26), (8, 18)])
@pytest.mark.parametrize("hole", [0, 3])
def test_array_of_dots_has_no_text(size: tuple[int, int], hole: int) -> None:
    for pitch in (4.5, 7.0):
        picture = array_of_dots(*size, pitch, hole)
        assert read_symbols(picture, None) == []
        assert read_symbols(255 - picture, None) == []
