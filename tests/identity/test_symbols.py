"""Codes in pictures: text, kind, corners, modules and error correction, of both polarities and of little contrast."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.identity.symbols import _proven, read_symbols
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


@pytest.mark.parametrize(
    ("modules", "corrections", "check", "proven"),
    [
        ((10, 10), 0, 5, True), ((10, 10), 1, 5, False), ((12, 12), 2, 7, True), ((12, 12), 3, 7, False),
        ((18, 8), 3, 7, False), ((8, 32), 5, 11, True), ((14, 14), 4, 10, True), ((14, 14), 5, 10, False),
        ((16, 16), 6, 12, True), ((24, 24), 12, 24, True),
    ],
)  # fmt: skip
def test_check_words_that_are_left_over_prove_a_text(
    modules: tuple[int, int], corrections: int, check: int, proven: bool
) -> None:
    # The reader states hundredths, rounded down.
    unused = np.floor(100 * (1 - 2 * corrections / check)) / 100
    assert _proven("datamatrix", modules, 1 - unused) is proven


def test_small_code_with_a_damaged_word_is_not_proven() -> None:
    dark = np.pad(symbol("datamatrix", "SN7"), 4)
    shown = np.where(np.kron(dark, np.ones((8, 8))) > 0, 0, 255).astype(np.uint8)
    assert [found.proven for found in read_symbols(shown, None)] == [True]
    shown[56:64, 56:64] = 255 - shown[56:64, 56:64]
    assert [(found.text, found.proven) for found in read_symbols(shown, None)] == [("SN7", False)]


def test_little_contrast_and_inverted_codes_are_read() -> None:
    assert [s.text for s in read_symbols(picture("datamatrix", 5, low=20, high=34), None)] == [TEXT]
    assert [s.text for s in read_symbols(picture("datamatrix", 5, low=200, high=40), None)] == [TEXT]
    assert read_symbols(np.full((60, 60), 7, np.uint8), None) == []
