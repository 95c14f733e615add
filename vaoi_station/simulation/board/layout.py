"""Where the parts of a generated board stand, and its board type.

Board coordinates: mm, origin in the top left corner as the camera sees the board, x right, y down.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import MM_PER_UNIT, BoardType, Component, Fiducial
from vaoi_station.simulation.board.packages import BIG, MIDDLE, SMALL, Package
from vaoi_station.simulation.scenario import BoardSection

_EDGE_MM = 1.5
_GAP_MM = 0.8
_TRIES = 60


@dataclass(frozen=True)
class Part:
    """One placed part; `turned_deg` counts counter-clockwise as the camera sees it."""

    ref: str
    package: Package
    place: tuple[float, float]
    turned_deg: float
    body_height_mm: float

    def to_board(self, local: Floats) -> Floats:
        """Board places (..., 2) of local ones (..., 2)."""
        a = math.radians(self.turned_deg)
        c, s = math.cos(a), math.sin(a)
        return np.asarray(local @ np.array([[c, -s], [s, c]]) + self.place)

    def to_board_point(self, u: float, v: float) -> tuple[float, float]:
        """The same for one point."""
        x, y = self.to_board(np.array([u, v]))
        return float(x), float(y)

    @property
    def half_extent(self) -> tuple[float, float]:
        """Half width and height of its footprint's upright bounding box."""
        return _half_extent(self.package, self.turned_deg)


def board_from_cad(section: BoardSection) -> Floats:
    """CAD coordinates to board coordinates, (3, 3): unit, y axis and side as the scenario says."""
    k = MM_PER_UNIT[section.unit]
    flip_x, flip_y = section.side == "bottom", section.y_axis == "up"
    return np.array(
        [
            [-k if flip_x else k, 0.0, section.width_mm if flip_x else 0.0],
            [0.0, -k if flip_y else k, section.length_mm if flip_y else 0.0],
            [0.0, 0.0, 1.0],
        ]
    )


def board_type(section: BoardSection, parts: tuple[Part, ...]) -> BoardType:
    """The CAD description of the board."""
    k = MM_PER_UNIT[section.unit]
    back = np.linalg.inv(board_from_cad(section))
    spin = -1.0 if section.side == "bottom" else 1.0

    def cad(x: float, y: float) -> tuple[float, float]:
        u, v = apply(back, (x, y))
        return round(float(u), 9), round(float(v), 9)

    fiducials = [
        Fiducial(
            name=f"FID{n + 1}",
            x=cad(m.x_mm, m.y_mm)[0],
            y=cad(m.x_mm, m.y_mm)[1],
            shape=m.shape,
            diameter=m.diameter_mm / k,
        )
        for n, m in enumerate(section.marks)
    ]
    components = [
        Component(
            ref=p.ref,
            center=cad(*p.place),
            width=p.package.size[0] / k,
            height=p.package.size[1] / k,
            rotation=(spin * p.turned_deg) % 360,
            body_height=p.body_height_mm / k,
        )
        for p in parts
    ]
    return BoardType(
        name=section.name,
        unit=section.unit,
        y_axis=section.y_axis,
        side=section.side,
        outline=(cad(0, 0), cad(section.width_mm, section.length_mm)),
        fiducials=tuple(fiducials),
        components=tuple(components),
    )


def place_parts(section: BoardSection) -> tuple[Part, ...]:
    """Parts of decreasing size at random free places, small ones in aligned groups."""
    return _Floor(section).fill()


class _Floor:
    """The board while parts are being set on it."""

    def __init__(self, section: BoardSection) -> None:
        self.section = section
        self.size = (section.width_mm, section.length_mm)
        self.g = np.random.default_rng([section.seed, 7010])
        self.parts: list[Part] = []
        self.numbers: Counter[str] = Counter()
        self.taken = [(m.x_mm, m.y_mm, 1.6 * m.diameter_mm + 0.4, 1.6 * m.diameter_mm + 0.4) for m in section.marks] + [
            (*place, 2.6, 2.6) for place in mounting_holes(section)
        ]

    def fill(self) -> tuple[Part, ...]:
        area_cm2 = self.section.width_mm * self.section.length_mm / 100
        wanted = round(self.section.density * area_cm2)
        for n in range(round(wanted * 0.09)):
            self._set(BIG[n % len(BIG)](), 1)
        for n in range(round(wanted * 0.14)):
            self._set(MIDDLE[n % len(MIDDLE)](), 1)
        misses = 0
        while len(self.parts) < wanted and misses < 40:
            package = SMALL[int(self.g.integers(len(SMALL)))]()
            misses += not self._set(package, min(int(self.g.integers(2, 7)), wanted - len(self.parts)))
        return tuple(self.parts)

    def _set(self, package: Package, count: int) -> bool:
        """Set a group of equal parts side by side; False where no place was found."""
        for _ in range(_TRIES):
            turned = 90.0 * int(self.g.integers(4))
            if package.name == "QFP-64" and self.numbers["U"] > 0:
                turned += 45.0
            half = _half_extent(package, turned)
            step = (0.0, 2 * half[1] + 0.5) if turned % 180 == 0 else (2 * half[0] + 0.5, 0.0)
            x, y = (self._anywhere(h, s) for h, s in zip(half, self.size, strict=True))
            places = [(round(x + n * step[0], 3), round(y + n * step[1], 3)) for n in range(count)]
            if all(self._free(place, half) for place in places):
                for place in places:
                    self._put(package, place, turned, half)
                return True
        return False

    def _anywhere(self, half: float, size: float) -> float:
        least = half + _EDGE_MM
        return float(self.g.uniform(least, max(size - least, least)))

    def _free(self, place: tuple[float, float], half: tuple[float, float]) -> bool:
        x, y = place
        inside = all(h + _EDGE_MM <= p <= s - h - _EDGE_MM for p, h, s in zip(place, half, self.size, strict=True))
        return inside and not any(
            abs(x - u) < half[0] + w + _GAP_MM and abs(y - v) < half[1] + h + _GAP_MM for u, v, w, h in self.taken
        )

    def _put(self, package: Package, place: tuple[float, float], turned: float, half: tuple[float, float]) -> None:
        self.numbers[package.prefix] += 1
        ref = f"{package.prefix}{self.numbers[package.prefix]}"
        height = round(package.body_height * self.section.height_scale, 4)
        self.parts.append(Part(ref, package, place, turned, height))
        self.taken.append((*place, *half))


def mounting_holes(section: BoardSection) -> tuple[tuple[float, float], ...]:
    """Two holes on large boards, in the corners the default fiducials leave free."""
    if min(section.width_mm, section.length_mm) < 45:
        return ()
    return (4.5, section.length_mm - 4.5), (section.width_mm / 2, 4.5)


def _half_extent(package: Package, turned_deg: float) -> tuple[float, float]:
    a = math.radians(turned_deg)
    c, s = abs(math.cos(a)), abs(math.sin(a))
    w, h = package.size
    return (w * c + h * s) / 2, (w * s + h * c) / 2
