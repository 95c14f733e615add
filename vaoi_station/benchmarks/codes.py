"""Measure how many codes are read: printed codes of the twin, and drawings of DataMatrix codes of dots.

Printed: every view is one frame of a small board. Blur, brightness, rotation, tilt of camera and board, kind and
polarity are random; motion blur, shot noise and vignetting are those of the twin. Dots: rotation, number of modules
and text are random, noise has 0.5 to 6 % of the contrast, blur a σ of 0.4 to 1.1 px; in disturbed drawings contrast,
sizes and places of the dots are random too, dots are missing, the ground is uneven, and other parts stand beside.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.identity.code_reader import read_codes
from vaoi_station.identity.symbols import read_symbols
from vaoi_station.model import BoardReading, Status, Stitch
from vaoi_station.simulation import Passage, Scenario, Twin

PX_PER_MM = 20.0
MODULES_PX = (2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
_BOARD_MM = 15.0
_FRAME_PX = 400


@dataclass(frozen=True)
class CodeRates:
    """How many views of codes with modules of one size were read."""

    module_px: float
    views: int
    read: int
    wrong: int
    """Views in which a text was read that is not that of the code."""
    off_mm: float
    ms: float

    def line(self) -> str:
        """Return the figures as one line of text."""
        share = 100 * self.read / self.views
        return (
            f"module {self.module_px:4.1f} px: {self.read} of {self.views} read ({share:.1f} %), {self.wrong} wrong, "
            f"place within {self.off_mm:.3f} mm, {self.ms:.0f} ms"
        )


def measure_code_reading(
    views: int, modules_px: Sequence[float] = MODULES_PX, report: Callable[[str], None] = lambda _: None
) -> list[CodeRates]:
    """Read codes in `views` views for each size of modules."""
    rates = []
    for module_px in modules_px:
        rates.append(_rates(module_px, views))
        report(rates[-1].line())
    return rates


def _rates(module_px: float, views: int) -> CodeRates:
    read = wrong = 0
    off_mm = took_s = 0.0
    for passage in _boards(module_px, views):
        [text] = passage.code_texts
        row = _best_row(passage)
        pixels = passage.frame(0, row)
        began_s = time.perf_counter()
        found = _read(passage, row, pixels)
        took_s += time.perf_counter() - began_s
        right = [code for code in found.codes if code.text == text]
        read += bool(right)
        wrong += len(right) < len(found.codes)
        middle = passage.twin.board_type.identity
        assert middle is not None
        off_mm = max([off_mm, *(float(np.hypot(*np.subtract(c.center, middle.places[0].center))) for c in right)])
    return CodeRates(module_px, views, read, wrong, round(off_mm, 4), round(1000 * took_s / views, 1))


def _boards(module_px: float, views: int) -> Iterator[Passage]:
    """Yield passages of boards, each of a scenario with other random conditions."""
    for view in range(views):
        g = np.random.default_rng([7060, round(10 * module_px), view])
        code = {
            "x_mm": _BOARD_MM / 2 + g.uniform(-0.05, 0.05),
            "y_mm": _BOARD_MM / 2 + g.uniform(-0.05, 0.05),
            "module_mm": module_px / PX_PER_MM,
            "symbology": "qr" if g.random() < 0.25 else "datamatrix",
            "turned_deg": g.uniform(0, 360),
            "inverted": bool(g.random() < 0.3),
        }
        scenario = {
            "array": {
                "cameras": 1, "width_px": _FRAME_PX, "height_px": _FRAME_PX, "px_per_mm": PX_PER_MM,
                "working_distance_mm": 300.0, "tilt_deg": 0.3, "psf_px": g.uniform(0.5, 1.2),
                "gain": g.uniform(0.4, 1.2), "seed": view,
            },
            "board": {
                "name": "bench", "width_mm": _BOARD_MM, "length_mm": _BOARD_MM, "density": 0.0, "fiducials": (),
                "tilt_mm": tuple(g.uniform(-0.7, 0.7, 2).tolist()), "codes": (code,),
            },
            "line": {"barrier_mm": -15.0, "start_delay_s": 0.05, "period_s": 0.05, "tail_s": 0.3},
        }  # fmt: skip
        yield Twin(Scenario.model_validate(scenario)).passage(view)


def _best_row(passage: Passage) -> int:
    """Return the row in which the middle of the board is closest to the middle of the frame."""
    middle, camera = np.full((1, 2), _BOARD_MM / 2), passage.pinholes[0]
    places = [camera.project(apply(passage.pose(t), middle), 0.0)[0] for t in passage.pulse_times_s]
    return int(np.argmin([np.hypot(*(place - (_FRAME_PX - 1) / 2)) for place in places]))


def _read(passage: Passage, row: int, pixels: Any) -> BoardReading:
    truth = {key: passage.truth()[key] for key in ("image_matrices", "cad_matrix", "row_motion")}
    stitch = Stitch(format="vaoi-stitch", version=1, method="auto", status=Status.OK, quality={}, **truth)
    twin = passage.twin
    return read_codes(twin.board_type, stitch, twin.cameras, lambda _camera, at: pixels if at == row else None)


DOTS, DOT_MODULES_PX = (1.0, 0.85, 0.7), (4.0, 5.0, 6.0, 8.0, 10.0)
_DIGITS = {
    1: 6, 2: 10, 3: 16, 4: 24, 5: 36, 6: 44, 7: 60, 8: 72, 9: 88,
    25: 10, 26: 20, 27: 32, 28: 44, 29: 64,
}  # fmt: skip
"""How many digits symbols hold, by version: 10 x 10 to 26 x 26, 8 x 18 to 16 x 36 (ISO/IEC 16022, table 7)."""
_FINE = 8
_CERTAIN = 1.96
"""Half the width of an interval that contains 95 % of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class DottedCode:
    """How a code of dots is drawn."""

    version: int = 3
    text: str = "12345678"
    module_px: float = 6.0
    dot: float = 0.85
    inverted: bool = False
    turned_deg: float = 0.0
    grey: tuple[float, float] = (70.0, 170.0)
    noise: float = 3.0
    blur_px: float = 0.7
    size_spread: float = 0.0
    displaced: float = 0.0
    """Largest displacement of a dot along each axis, in modules."""
    missing: float = 0.0
    oblique: float = 0.0
    """How much larger the nearest side of the code is than the farthest, about, as a share."""
    brushed: float = 0.0
    """Standard deviation of a ground with stripes, grey levels."""
    shaded: float = 0.0
    """Difference of the ground's brightness from one side to the other, grey levels."""
    room: float = 1.7
    """Side of the picture, as a multiple of the code's longer one."""
    parts: int = 0
    """Number of parts beside the code, as light or dark as its dots, at least one module away."""
    label: float | None = None
    """Width of the ground round the code in modules; what is farther away is as light or dark as the dots."""
    seed: int = 0


@dataclass(frozen=True)
class DottedRates:
    """How many drawings of one kind were read."""

    dot: float
    module_px: float
    inverted: bool
    disturbed: bool
    drawings: int
    read: int
    wrong: int
    """Drawings in which a text was read that is not that of the code."""
    off_px: float
    """Largest error of a corner of those that were read."""
    share: tuple[float, float]

    def line(self) -> str:
        """Return the figures as one line of text."""
        low, high = (100 * limit for limit in self.share)
        kind = f"{'light' if self.inverted else 'dark'} dots of {self.dot:.2f} modules of {self.module_px:4.1f} px"
        return (
            f"{kind}{', disturbed' if self.disturbed else ''}: {self.read} of {self.drawings} read "
            f"({low:.1f} to {high:.1f} %), {self.wrong} wrong, corners within {self.off_px:.1f} px"
        )


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by its Wilson score (Wilson 1927), which holds near 0 and 1 too."""
    z2 = _CERTAIN**2
    middle = (hits + z2 / 2) / (count + z2)
    reach = _CERTAIN / (count + z2) * math.sqrt(hits * (count - hits) / count + z2 / 4)
    return round(max(middle - reach, 0.0), 4), round(min(middle + reach, 1.0), 4)


def measure_dotted_codes(
    drawings: int,
    dots: Sequence[float] = DOTS,
    modules_px: Sequence[float] = DOT_MODULES_PX,
    report: Callable[[str], None] = lambda _: None,
) -> list[DottedRates]:
    """Read `drawings` drawings of each size of dots and modules, of either polarity, disturbed and not."""
    rates = []
    kinds = [
        (d, m, inverted, bad) for bad in (False, True) for inverted in (False, True) for d in dots for m in modules_px
    ]
    for dot, module_px, inverted, disturbed in kinds:
        read = wrong = 0
        off_px = 0.0
        for n in range(drawings):
            g = np.random.default_rng([7061, round(100 * dot), round(10 * module_px), inverted, disturbed, n])
            code = _random_code(g, disturbed, dot=dot, module_px=module_px, inverted=inverted)
            picture, corners = draw_dotted_code(code)
            found = read_symbols(picture, "datamatrix") or read_symbols(picture, "datamatrix", enlarged=2)
            right = [symbol for symbol in found if symbol.text == code.text]
            read += bool(right)
            wrong += len(right) < len(found)
            off_px = max([off_px, *(float(np.hypot(*(s.corners_px - corners).T).max()) for s in right)])
        figures = drawings, read, wrong, round(off_px, 2), interval(read, drawings)
        rates.append(DottedRates(dot, module_px, inverted, disturbed, *figures))
        report(rates[-1].line())
    return rates


def _random_code(g: np.random.Generator, disturbed: bool, **fixed: Any) -> DottedCode:
    version = int(g.choice([*_DIGITS]))
    count = int(_DIGITS[version] * g.uniform(0.6, 1.0))
    contrast = float(g.uniform(25, 140)) if disturbed else 100.0
    low = float(g.uniform(20, 230 - contrast)) if disturbed else 70.0
    drawn: dict[str, Any] = {
        "version": version, "text": "".join(map(str, g.integers(0, 10, count))), "turned_deg": g.uniform(0, 360),
        "grey": (low, low + contrast), "noise": max(0.5, contrast * g.uniform(0.005, 0.06)),
        "blur_px": g.uniform(0.4, 1.1), "seed": int(g.integers(1 << 31)),
    }  # fmt: skip
    if disturbed:
        drawn |= {
            "size_spread": g.uniform(0, 0.12), "displaced": g.uniform(0, 0.1), "missing": g.choice([0, 0, 0.01, 0.02]),
            "oblique": g.uniform(0, 0.08), "brushed": contrast * g.choice([0, 0.06, 0.12]),
            "shaded": contrast * g.uniform(0, 0.25), "room": g.uniform(1.3, 4), "parts": int(g.choice([0, 0, 12, 24])),
            "label": g.uniform(1.5, 4) if g.random() < 0.2 else None,
        }  # fmt: skip
    return DottedCode(**drawn, **fixed)


def draw_dotted_code(code: DottedCode) -> tuple[NDArray[np.uint8], Floats]:
    """Draw a code of dots; return the picture and the code's corners (4, 2) in it, from its own top left one on."""
    import zxingcpp

    written = zxingcpp.create_barcode(code.text, zxingcpp.BarcodeFormat.DataMatrix, version=code.version)
    dark = np.array(written.to_image(scale=1, add_quiet_zones=False)) < 128
    g = np.random.default_rng(code.seed)
    size = np.array(dark.shape[::-1])
    side = int(code.module_px * size.max() * code.room) + 20
    a = math.radians(code.turned_deg)
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) * code.module_px
    tilt = g.uniform(-1, 1, 2) * code.oblique / size.max()
    middle = (side - 1) / 2 + g.uniform(-2, 2, 2)

    def to_px(modules: Any) -> Floats:
        from_middle = np.asarray(modules, np.float64) - size / 2
        return np.asarray((from_middle / (1 + from_middle @ tilt)[..., None]) @ turn.T + middle)

    fine = np.zeros((side * _FINE, side * _FINE), np.uint8)
    margin = code.label or 0.0
    (w, h), low, high = size, np.full(2, -margin), size + margin
    if code.label is not None:
        fine[:] = 255
        edge = to_px([low, (high[0], low[1]), high, (low[0], high[1])])
        cv2.fillPoly(fine, [np.round(_to_fine(edge)).astype(np.int32)], 0)
    for y, x in np.argwhere(dark):
        place = to_px((x + 0.5, y + 0.5) + g.uniform(-1, 1, 2) * code.displaced)
        diameter = code.dot * (1 + g.uniform(-1, 1) * code.size_spread)
        if g.random() >= code.missing:
            _draw_disk(fine, place, diameter * code.module_px / 2)
    corners = to_px([(0, 0), (w, 0), (w, h), (0, h)])
    _draw_parts(fine, corners, code, g)
    cover = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    dots, ground = code.grey[::-1] if code.inverted else code.grey
    picture = ground + (dots - ground) * cover + code.brushed * _stripes(side, g)
    picture = cv2.GaussianBlur(picture, (0, 0), code.blur_px)
    picture += code.shaded * (np.arange(side) / side - 0.5) + g.normal(0, code.noise, picture.shape)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8), corners


def _draw_parts(fine: NDArray[np.uint8], corners: Floats, code: DottedCode, g: np.random.Generator) -> None:
    """Draw disks and bars beside a code."""
    outline = corners.astype(np.float32)
    for n in range(code.parts):
        place, reach = g.uniform(0, len(fine) / _FINE, 2), g.uniform(0.5, 2) * code.module_px
        if cv2.pointPolygonTest(outline, tuple(map(float, place)), True) > -reach - code.module_px:
            continue
        if n % 2:
            _draw_disk(fine, place, reach)
        else:
            along = np.array([math.cos(n), math.sin(n)]) * reach * 0.8
            ends = [tuple(np.round(_to_fine(place + s * along)).astype(int).tolist()) for s in (-1, 1)]
            cv2.line(fine, ends[0], ends[1], 255, max(int(0.3 * reach * _FINE), 1))


def _draw_disk(fine: NDArray[np.uint8], place: Floats, radius_px: float) -> None:
    x, y = np.round(16 * _to_fine(place)).astype(int).tolist()
    cv2.circle(fine, (x, y), round(16 * radius_px * _FINE), 255, -1, shift=4)


def _to_fine(px: Floats) -> Floats:
    return (px + 0.5) * _FINE - 0.5


def _stripes(side: int, g: np.random.Generator) -> Floats:
    """Return a ground of stripes in any direction, with a standard deviation of 1."""
    along = cv2.GaussianBlur(g.normal(0, 1, (side, side)), (0, 0), sigmaX=12, sigmaY=0.6)
    turn = cv2.getRotationMatrix2D((side / 2, side / 2), g.uniform(0, 180), 1.5)
    turned = cv2.warpAffine(along, turn, (side, side), borderMode=cv2.BORDER_REFLECT)
    return np.asarray(turned / turned.std(), np.float64)
