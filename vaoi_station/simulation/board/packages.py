"""Packages of the parts: footprints, leads and bodies in millimetres, before rotation.

Local coordinates: origin in the centre of the footprint, u to the right, v down as the camera sees it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

Box = tuple[float, float, float, float]
"""A rectangle in local coordinates: centre u, v and size w, h, mm."""


class Finish(StrEnum):
    """The style in which the top of a body is painted."""

    EPOXY = "epoxy"
    RESISTOR = "resistor"
    CERAMIC = "ceramic"
    CAN = "can"
    COIL = "coil"
    CRYSTAL = "crystal"
    SOCKET = "socket"
    HEADER = "header"


@dataclass(frozen=True)
class Package:
    """A package, that is one kind of part: its footprint, body, pads and leads, in mm."""

    name: str
    prefix: str
    size: tuple[float, float]
    """Width and height of the footprint including the pads, as in the CAD data."""
    body: tuple[float, float]
    body_height: float
    finish: Finish
    pads: tuple[Box, ...]
    leads: tuple[Box, ...] = ()

    @property
    def small(self) -> bool:
        """Whether the package is that of a chip resistor or capacitor. Such parts are placed in groups."""
        return self.finish in (Finish.RESISTOR, Finish.CERAMIC)

    @property
    def round(self) -> bool:
        """Whether the body is a cylinder."""
        return self.finish is Finish.CAN


def chip(name: str, prefix: str, size: tuple[float, float], height: float, finish: Finish) -> Package:
    """Return the package of a chip resistor or capacitor, which has two terminals."""
    length, width = size
    pad = max(0.35 * length, 0.35)
    offset, tall = length / 2, width * 1.1
    # Pads are 10 % wider than the chip, so that solder is visible beside the chip.
    pads = ((-offset, 0.0, pad, tall), (offset, 0.0, pad, tall))
    return Package(name, prefix, (length + pad, tall), size, height, finish, pads)


def small_outline(name: str, *, pins: int, pitch: float, body: tuple[float, float], height: float) -> Package:
    """Return a package with gull-wing leads on the left and right (SOIC, TSSOP)."""
    reach, wide = 0.9, pitch * 0.4
    pads, leads = _row_pair(pins // 2, pitch, body[0], reach, wide)
    return Package(name, "U", (body[0] + 2 * reach + 0.4, body[1]), body, height, Finish.EPOXY, pads, leads)


def quad_flat(name: str, *, pins: int, pitch: float, body: float, height: float) -> Package:
    """Return a square package with leads on all four sides (QFP)."""
    reach, wide = 1.0, pitch * 0.5
    pads, leads = _row_pair(pins // 4, pitch, body, reach, wide)
    turned = tuple((v, u, h, w) for u, v, w, h in pads)
    turned_leads = tuple((v, u, h, w) for u, v, w, h in leads)
    size = body + 2 * reach + 0.4
    return Package(name, "U", (size, size), (body, body), height, Finish.EPOXY, pads + turned, leads + turned_leads)


def sot23() -> Package:
    """Return the package of a transistor with three leads (SOT-23)."""
    pads = ((-0.95, 1.1, 0.7, 0.9), (0.95, 1.1, 0.7, 0.9), (0.0, -1.1, 0.7, 0.9))
    leads = ((-0.95, 1.0, 0.4, 0.7), (0.95, 1.0, 0.4, 0.7), (0.0, -1.0, 0.4, 0.7))
    return Package("SOT-23", "Q", (2.9, 3.1), (2.9, 1.3), 1.0, Finish.EPOXY, pads, leads)


def can_capacitor(diameter: float, height: float) -> Package:
    """Return the package of an electrolytic capacitor: a cylinder on two pads."""
    pad = ((-diameter * 0.45, 0.0, diameter * 0.35, 1.2), (diameter * 0.45, 0.0, diameter * 0.35, 1.2))
    name = f"CAN-{diameter:g}"
    return Package(name, "C", (diameter * 1.25, diameter), (diameter, diameter), height, Finish.CAN, pad)


def header(columns: int, rows: int) -> Package:
    """Return the package of a pin header with a pitch of 2.54 mm."""
    at = [((i - (columns - 1) / 2) * 2.54, (j - (rows - 1) / 2) * 2.54) for j in range(rows) for i in range(columns)]
    pads = tuple((u, v, 1.6, 1.6) for u, v in at)
    size = (columns * 2.54, rows * 2.54)
    return Package(f"HDR-{columns}x{rows}", "J", size, size, 2.5, Finish.HEADER, pads)


def socket(width: float, depth: float, height: float) -> Package:
    """Return the package of a shielded connector with one row of pads."""
    n = max(int(width / 1.6), 2)
    pads = tuple(((i - (n - 1) / 2) * 1.3, -depth / 2 - 0.3, 0.7, 1.2) for i in range(n))
    return Package(f"SOCKET-{width:g}", "J", (width, depth + 1.8), (width, depth), height, Finish.SOCKET, pads)


def _row_pair(
    count: int, pitch: float, body_w: float, reach: float, wide: float
) -> tuple[tuple[Box, ...], tuple[Box, ...]]:
    """Return pads and leads of a package with `count` leads on its left and right, which reach beyond the body."""
    at = [(i - (count - 1) / 2) * pitch for i in range(count)]
    pad_at, lead_at = body_w / 2 + reach * 0.65, body_w / 2 + reach * 0.45
    pads = tuple((side * pad_at, v, reach * 1.1, wide * 1.3) for side in (-1, 1) for v in at)
    leads = tuple((side * lead_at, v, reach * 0.9, wide) for side in (-1, 1) for v in at)
    return pads, leads


def package_of(ref: str, body: tuple[float, float], height: float | None) -> Package:
    """Return a package for a part of which only designator and body are known: a chip, or a body with leads.

    Without a height, the body is a third of its shorter side high, at most 3 mm.
    """
    letters = ref.rpartition("/")[2].rstrip("0123456789")
    length, width = max(body), min(body)
    tall = min(max(width / 3, 0.3), 3.0) if height is None else height
    if letters in ("R", "C", "L", "D", "FB", "F") and length <= _LONGEST_CHIP_MM:
        finish = Finish.RESISTOR if letters == "R" else Finish.CERAMIC
        package = chip("chip", letters, (length, width), tall, finish)
    else:
        pitch = 1.27 if length > 3 else 0.65
        pads, leads = _row_pair(max(int((length - 0.5) / pitch), 1), pitch, width, 0.6, 0.4 * pitch)
        pads, leads = (tuple((v, u, h, w) for u, v, w, h in boxes) for boxes in (pads, leads))
        finish = Finish.HEADER if letters in ("J", "P", "X", "CN") else Finish.EPOXY
        package = Package("body", letters or "U", (length, width), (length, width), tall, finish, pads, leads)
    if body[0] >= body[1]:
        return package
    pads, leads = (tuple((v, u, h, w) for u, v, w, h in boxes) for boxes in (package.pads, package.leads))
    return replace(package, size=package.size[::-1], body=package.body[::-1], pads=pads, leads=leads)


_LONGEST_CHIP_MM = 7.0
"""Length above which a part with two terminals is drawn as a body with leads."""


# The tables hold functions, so that packages are built when a board needs them and not on import.
BIG: tuple[Callable[[], Package], ...] = (
    lambda: quad_flat("QFP-64", pins=64, pitch=0.65, body=12.0, height=1.4),
    lambda: header(8, 2),
    lambda: socket(9.0, 7.0, 3.2),
    lambda: can_capacitor(6.3, 5.4),
    lambda: small_outline("SOIC-16", pins=16, pitch=1.27, body=(3.9, 9.9), height=1.5),
    lambda: Package(
        "COIL", "L", (7.4, 6.6), (6.6, 6.6), 3.0, Finish.COIL, ((-3.0, 0.0, 1.4, 3.0), (3.0, 0.0, 1.4, 3.0))
    ),
    lambda: small_outline("TSSOP-20", pins=20, pitch=0.65, body=(4.4, 6.5), height=1.1),
    lambda: can_capacitor(8.0, 6.2),
)
"""Large packages; a board uses them in this order."""

MIDDLE: tuple[Callable[[], Package], ...] = (
    lambda: small_outline("SOIC-8", pins=8, pitch=1.27, body=(3.9, 4.9), height=1.5),
    sot23,
    lambda: Package(
        "XTAL", "Y", (5.8, 3.2), (5.0, 3.2), 0.9, Finish.CRYSTAL, ((-2.2, 0.0, 1.4, 2.4), (2.2, 0.0, 1.4, 2.4))
    ),
    sot23,
    lambda: chip("1206", "C", (3.2, 1.6), 1.2, Finish.CERAMIC),
    lambda: chip("1210", "R", (3.2, 2.5), 0.6, Finish.RESISTOR),
)


SMALL: tuple[Callable[[], Package], ...] = (
    lambda: chip("0603", "R", (1.6, 0.8), 0.45, Finish.RESISTOR),
    lambda: chip("0402", "C", (1.0, 0.5), 0.5, Finish.CERAMIC),
    lambda: chip("0603", "C", (1.6, 0.8), 0.8, Finish.CERAMIC),
    lambda: chip("0402", "R", (1.0, 0.5), 0.35, Finish.RESISTOR),
    lambda: chip("0805", "C", (2.0, 1.25), 1.0, Finish.CERAMIC),
    lambda: chip("0805", "R", (2.0, 1.25), 0.5, Finish.RESISTOR),
)


def light_emitting_diode() -> Package:
    """Return the package of an LED: the only part of boards with a grid."""
    return chip("LED", "D", (1.0, 0.9), 0.5, Finish.CERAMIC)
