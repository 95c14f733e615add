"""Codes in one picture: read by zxing-cpp, with their corners, module size and error correction."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.identity.dot_grids import MODULES_PX, dot_grids
from vaoi_station.model.board_identity import Symbology

_STRETCHED = (1.0, 99.5)
"""Percentiles of the grey levels that become black and white."""
_SMALL = {(10, 10): (3, 5), (12, 12): (5, 7), (8, 18): (5, 7), (14, 14): (8, 10)}
"""Numbers of data and check words of the smallest DataMatrix codes, by their modules (ISO/IEC 16022, table 7)."""
_PROVEN = 1e-9
"""Chance of a wrong text below which one picture suffices. A run tries at most some hundred forms of what may be a
symbol: of 24 x 24 mm of a populated board, about 0.1 in a picture for printed codes and 0.03 in one for dots, and of an
array of dots about 0.2."""
_SIZE = re.compile(r"(\d+)x(\d+)")


@dataclass(frozen=True, eq=False)
class Symbol:
    """A code in a picture."""

    text: str
    symbology: Symbology
    corners_px: Floats
    """(4, 2) corners, going round from the code's own top left one; right to about one pixel."""
    module_px: float
    error_correction_used: float
    proven: bool
    """Whether the check words that its correction left over rule out another text (`_proven`)."""


def read_symbols(
    picture: NDArray[np.uint8], symbology: Symbology | None, *, enlarged: int = 1, dotted: bool = True
) -> list[Symbol]:
    """Return the codes in a grey picture (h, w), upright or not, dark on light or inverted.

    Codes of dots are searched only if there are no others, and not in a picture that is enlarged.
    """
    found = _read_solid(picture, symbology, enlarged)
    return read_dotted(picture) if dotted and not found and enlarged == 1 and symbology != "qr" else found


def read_dotted(picture: NDArray[np.uint8]) -> list[Symbol]:
    """Return the DataMatrix codes of dots in a picture (h, w), light or dark ones, if their modules are of one size."""
    return next(filter(None, (_read_grids(picture, module_px) for module_px in MODULES_PX)), [])


def _read_grids(picture: NDArray[np.uint8], module_px: float) -> list[Symbol]:
    import zxingcpp

    wanted: Any = [zxingcpp.BarcodeFormat.DataMatrix]
    symbols = []
    for grid in dot_grids(picture, module_px):
        drawn = np.kron(np.pad(~grid.modules, 2, constant_values=True), np.ones((4, 4)))
        found = zxingcpp.read_barcodes(
            np.asarray(255 * drawn, np.uint8), formats=wanted, is_pure=True, text_mode=zxingcpp.TextMode.Plain,
            binarizer=zxingcpp.Binarizer.FixedThreshold,
        )  # fmt: skip
        symbols += [s for code in found if (s := _symbol(code, "datamatrix", grid.corners_px)) is not None]
    return symbols


def _read_solid(picture: NDArray[np.uint8], symbology: Symbology | None, enlarged: int) -> list[Symbol]:
    # Imported here: its machine code is needed by few processes.
    import zxingcpp

    formats: dict[Symbology, Any] = {
        "datamatrix": zxingcpp.BarcodeFormat.DataMatrix,
        "qr": zxingcpp.BarcodeFormat.QRCode,
    }
    wanted: Any = [formats[symbology]] if symbology else [*formats.values()]
    picture = _stretched(picture)
    if enlarged > 1:
        picture = np.asarray(
            cv2.resize(picture, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC), np.uint8
        )
    found = zxingcpp.read_barcodes(
        np.ascontiguousarray(picture), formats=wanted, text_mode=zxingcpp.TextMode.Plain, try_downscale=enlarged == 1
    )
    names = {value: key for key, value in formats.items()}
    symbols = []
    for code in found:
        at = code.position
        # The reader counts from the corner of the first pixel, pictures from its centre.
        points = (at.top_left, at.top_right, at.bottom_right, at.bottom_left)
        corners = (np.array([(p.x, p.y) for p in points], dtype=np.float64)) / enlarged - 0.5
        if (symbol := _symbol(code, names.get(code.format), corners)) is not None:
            symbols.append(symbol)
    return symbols


def _stretched(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with its grey levels stretched to all of 0 to 255.

    The reader takes squares of 8 × 8 px with less than 24 grey levels of contrast for even ground.
    """
    low, high = np.percentile(picture, _STRETCHED)
    if high - low < 1:
        return picture
    levels = np.clip((np.arange(256) - low) * (255 / (high - low)), 0, 255)
    return np.asarray(cv2.LUT(picture, levels.astype(np.uint8)), np.uint8)


def _symbol(code: Any, symbology: Symbology | None, corners: Floats) -> Symbol | None:
    """Return a code that zxing-cpp has read; None if it lacks what a symbol states."""
    modules = _modules(code.extra) if code.text else None
    if symbology is None or modules is None:
        return None
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    module = float((sides[::2].sum() / modules[0] + sides[1::2].sum() / modules[1]) / 4)
    used = min(max(1.0 - float(code.extra.get("UEC", 0.0)), 0.0), 1.0)
    if module <= 0:
        return None
    return Symbol(code.text, symbology, corners, module, round(used, 4), _proven(symbology, modules, used))


def _proven(symbology: Symbology, modules: tuple[int, int], used: float) -> bool:
    """Return whether random words would be accepted with that many corrections in fewer than one of 10⁹ cases.

    Of the 256ⁿ combinations of the n check words of a Reed–Solomon code one is right; a symbol of m words with at most
    e wrong ones has Σ C(m, i) · 255ⁱ forms (i ≤ e). The chance is their product: 2·10⁻⁹ for the smallest DataMatrix
    with one correction, 6·10⁻¹¹ for the next larger one with two.
    """
    # All others have at most 5·10⁻¹⁰ at their limit: DataMatrix with 16 × 16 modules, QR of version 2.
    small = None if symbology == "qr" else _SMALL.get((min(modules), max(modules)))
    if small is None:
        return True
    data, check = small
    wrong = round(used * check / 2)
    forms = sum(math.comb(data + check, i) * 255**i for i in range(wrong + 1))
    return bool(forms < _PROVEN * 256**check)


def _modules(extra: dict[str, Any]) -> tuple[int, int] | None:
    """Return the numbers of modules across and down; None if the reader does not state them."""
    version = str(extra.get("Version", ""))
    if (size := _SIZE.fullmatch(version)) is not None:
        # A rectangular DataMatrix is stated as rows x columns.
        return int(size[2]), int(size[1])
    return (17 + 4 * int(version),) * 2 if version.isdigit() else None
