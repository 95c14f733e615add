"""The codes on boards of the twin: labels with serial number and type, different on every board."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardIdentity, CodePlace
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.layout import board_from_cad
from vaoi_station.simulation.scenario import BoardSection, CodeSection

QUIET_MODULES = 2
"""Width of the empty border of a label; DataMatrix asks for one module, QR for four, of which readers need fewer."""
_LIGHT, _DARK = 205.0, 40.0
_ROOM = 0.75
"""Half the side of the place of a code, as a multiple of its label: enough for one that lies turned by 45°."""
_DOT_CELLS = 32
"""Number of cells per module and axis of which dots are drawn."""
_FINE = 4
"""Number of samples per pixel and axis at the edges of modules."""


def code_text(code: CodeSection, board_name: str, board_number: int) -> str:
    """Return the text of the code of board `board_number`, which counts from 0."""
    return code.text.replace("{name}", board_name).replace("{serial}", f"SN{board_number + 1:06d}")


@lru_cache(maxsize=64)
def symbol(symbology: str, text: str) -> NDArray[np.bool_]:
    """Return the modules (n, n) of a code, True where they are dark, without a border.

    A DataMatrix is an ECC 200 symbol of ISO/IEC 16022, square; a QR code is of level M of ISO/IEC 18004.
    """
    import zxingcpp  # imported here: most twins have no codes

    if symbology == "datamatrix":
        code = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.DataMatrix, force_square=True)
    else:
        code = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.QRCode, ec_level="M")
    dark = np.array(code.to_image(scale=1, add_quiet_zones=False)) < 128
    dark.setflags(write=False)
    return np.asarray(dark, np.bool_)


def identity_of(section: BoardSection) -> BoardIdentity | None:
    """Describe the codes of a board, with their common pattern, if they have one; None without codes."""
    if not section.codes:
        return None
    patterns = {code.text.replace("{name}", section.name).replace("{serial}", "{id}") for code in section.codes}
    back, board = np.linalg.inv(board_from_cad(section)), np.array([section.width_mm, section.length_mm])
    places = []
    for code in section.codes:
        # The label has the same size on all boards.
        modules = len(symbol(code.symbology, code_text(code, section.name, 0))) + 2 * QUIET_MODULES
        reach, middle = _ROOM * (modules * code.module_mm), np.array([code.x_mm, code.y_mm])
        corners = np.clip([middle - reach, middle + reach], 0, board)
        a, b = apply(back, corners)
        (x, y), (w, h) = ((a + b) / 2).tolist(), np.abs(b - a).tolist()
        center = round(x, 9), round(y, 9)
        places.append(CodePlace(center=center, width=round(w, 9), height=round(h, 9), panel=code.panel))
    return BoardIdentity(pattern=patterns.pop() if len(patterns) == 1 else None, places=tuple(places))


def draw_label(code: CodeSection, board_name: str, board_number: int, px_per_mm: float) -> Body:
    """Draw the label of one board, as a body without height."""
    modules = np.pad(symbol(code.symbology, code_text(code, board_name, board_number)), QUIET_MODULES)
    half = len(modules) * code.module_mm / 2
    if code.dot_modules is not None:
        # Every dark module becomes cells, of which those within a dot in its middle are dark.
        at = (np.arange(_DOT_CELLS) + 0.5) / _DOT_CELLS - 0.5
        modules = np.asarray(np.kron(modules, np.hypot(*np.meshgrid(at, at)) <= code.dot_modules / 2), np.bool_)
    count = len(modules)
    a = math.radians(code.turned_deg)
    c, s = math.cos(a), math.sin(a)
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    # Counter-clockwise as the camera sees it, with y down.
    outline: Floats = corners @ np.array([[c, -s], [s, c]]) + (code.x_mm, code.y_mm)
    low = np.floor((outline.min(0)) * px_per_mm - 2) / px_per_mm
    size = np.ceil((outline.max(0) - low) * px_per_mm).astype(int) + 2
    fine = px_per_mm * _FINE
    # From modules, or their cells, to samples: the centres of both are integers.
    turn = np.array([[c, s], [-s, c]]) * 2 * half / count * fine
    middle = (np.array([code.x_mm, code.y_mm]) - low) * fine - 0.5
    matrix = np.column_stack([turn, middle - turn @ np.full(2, (count - 1) / 2)])
    wide = (int(size[0]) * _FINE, int(size[1]) * _FINE)
    shown = (np.where(modules ^ code.inverted, _DARK, _LIGHT)).astype(np.uint8)
    ground = _DARK if code.inverted else _LIGHT
    grey = cv2.warpAffine(
        shown, matrix, wide, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=ground
    )
    cover = cv2.warpAffine(np.full_like(shown, 255), matrix, wide, flags=cv2.INTER_NEAREST, borderValue=0)
    area = (int(size[0]), int(size[1]))
    top, covered = (np.asarray(cv2.resize(p, area, interpolation=cv2.INTER_AREA), np.uint8) for p in (grey, cover))
    return Body(
        ref="",
        outline_mm=outline,
        height_mm=0.0,
        side_grey=ground,
        center_mm=(code.x_mm, code.y_mm),
        top=top,
        metal=np.zeros_like(top),
        cover=covered,
        origin_mm=(float(low[0]), float(low[1])),
        px_per_mm=px_per_mm,
    )
