"""Place the parts of a generated board, and describe the board as CAD data.

Board coordinates: mm, origin in the top left corner as the camera sees the board, x right, y down.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vaoi_station.files import read_board_type
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import MM_PER_UNIT, BoardIdentity, BoardType, Component, Fiducial, OtherMark
from vaoi_station.simulation.board.packages import BIG, MIDDLE, SMALL, Package, light_emitting_diode, package_of
from vaoi_station.simulation.board.panel import BadMark, bad_marks_at, marks_at, nominal_poses, real_poses
from vaoi_station.simulation.scenario import BoardSection, FiducialMark

_EDGE_MM = 1.5
_GAP_MM = 0.8
_TRIES = 60
_AT_MM = 0.05
"""Distance below which a component of a given board is its fiducial, mm."""


@dataclass(frozen=True)
class Part:
    """One placed part. Its rotation `turned_deg` is counter-clockwise as the camera sees it."""

    ref: str
    package: Package
    place: tuple[float, float]
    turned_deg: float
    body_height_mm: float

    def to_board(self, local: Floats) -> Floats:
        """Convert local coordinates (..., 2) of the part to board coordinates (..., 2), both in mm."""
        a = math.radians(self.turned_deg)
        c, s = math.cos(a), math.sin(a)
        return np.asarray(local @ np.array([[c, -s], [s, c]]) + self.place)

    def to_board_point(self, u: float, v: float) -> tuple[float, float]:
        """Convert one point (u, v) in local coordinates to board coordinates (x, y), both in mm."""
        x, y = self.to_board(np.array([u, v]))
        return float(x), float(y)

    @property
    def half_extent(self) -> tuple[float, float]:
        """Half the width and half the height of the footprint's bounding box in board coordinates, mm."""
        return _half_extent(self.package, self.turned_deg)


def board_from_cad(section: BoardSection) -> Floats:
    """Return the matrix (3, 3) from CAD to board coordinates, by the unit, axes and side that the scenario states."""
    k, (x0, y0) = MM_PER_UNIT[section.unit], section.origin
    flip_x, flip_y = section.side == "bottom", section.y_axis == "up"
    return np.array(
        [
            [-k if flip_x else k, 0.0, section.width_mm + k * x0 if flip_x else -k * x0],
            [0.0, -k if flip_y else k, section.length_mm + k * y0 if flip_y else -k * y0],
            [0.0, 0.0, 1.0],
        ]
    )


def board_type(section: BoardSection, parts: tuple[Part, ...], identity: BoardIdentity | None = None) -> BoardType:
    """Describe a generated board, and its codes, as CAD data, in the unit and axes that the scenario states."""
    k = MM_PER_UNIT[section.unit]
    if section.file is not None:
        given = read_board_type(section.file)
        return given if identity is None else given.model_copy(update={"identity": identity})
    back = np.linalg.inv(board_from_cad(section))
    # CAD data describe a board as seen from its top side, so rotations on the bottom side have the opposite sign.
    spin = -1.0 if section.side == "bottom" else 1.0

    def cad(x: float, y: float) -> tuple[float, float]:
        u, v = apply(back, (x, y))
        # The inverse matrix gives values like 12.299999999999999, so coordinates are rounded to nine decimals.
        return round(float(u), 9), round(float(v), 9)

    def fiducial(name: str, m: FiducialMark, position: str | None = None) -> Fiducial:
        x, y = cad(m.x_mm, m.y_mm)
        return Fiducial(name=name, x=x, y=y, shape=m.shape, diameter=m.diameter_mm / k, panel=position)

    def bad_mark(position: str, m: BadMark) -> OtherMark:
        x, y = cad(m.x_mm, m.y_mm)
        name, diameter = f"BBM{position}", m.diameter_mm / k
        return OtherMark(
            name=name, x=x, y=y, diameter=diameter, kind="bad-board", panel=position, good=m.good, bad=m.bad
        )

    fiducials = [fiducial(f"FID{n + 1}", m) for n, m in enumerate(section.marks)]
    if section.panel is not None:
        poses = nominal_poses(section.panel)
        # CAD data state where boards should lie, not where they do.
        parts = _parts_of_panel(section, poses)
        fiducials += [
            fiducial(f"{position}/FID{n + 1}", m, position)
            for position, marks in marks_at(section.panel, poses).items()
            for n, m in enumerate(marks)
        ]
    bad_marks = [] if section.panel is None else bad_marks_at(section.panel, nominal_poses(section.panel)).items()
    components = [
        Component(
            ref=p.ref.rpartition("/")[2],
            panel=p.ref.rpartition("/")[0] or None,
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
        other_marks=tuple(bad_mark(position, mark) for position, mark in bad_marks) or None,
        components=tuple(components),
        identity=identity,
    )


def surface_z(section: BoardSection, board_mm: Floats) -> Floats:
    """Return the height (k,), mm, of the board's surface above the calibrated plane at board coordinates (k, 2)."""
    u, v = (board_mm / (section.width_mm, section.length_mm) * 2 - 1).T
    bow = section.bow_mm * (1 - (0.4 * u * u + 0.6 * v * v))
    return np.asarray(section.lift_mm + section.tilt_mm[0] * u + section.tilt_mm[1] * v + bow)


@lru_cache(maxsize=4)
def place_parts(section: BoardSection) -> tuple[Part, ...]:
    """Place parts at random free positions: large parts first, small parts last and in aligned groups.

    A board with a `file` has the parts of that board type. A board with `grid_mm` has equal parts on a regular grid
    instead, as boards of LEDs have.
    """
    if section.file is not None:
        return _given_parts(section, read_board_type(section.file))
    if section.panel is not None:
        return _parts_of_panel(section, real_poses(section.panel))
    placer = _PartPlacer(section)
    return placer.fill() if section.grid_mm is None else placer.fill_grid(section.grid_mm)


def _parts_of_panel(section: BoardSection, poses: dict[str, Floats]) -> tuple[Part, ...]:
    """Return the parts of all boards of a panel, named `position/ref`, with the boards at these poses."""
    panel = section.panel
    assert panel is not None
    # Parts keep clear of the bad-board mark, as of a fiducial.
    kept = (*panel.fiducials, *(() if panel.bad_mark is None else (panel.bad_mark,)))
    one = {"width_mm": panel.width_mm, "length_mm": panel.length_mm, "panel": None, "codes": (), "fiducials": kept}
    parts = _PartPlacer(section.model_copy(update=one)).fill()

    def moved(part: Part, position: str, pose: Floats) -> Part:
        x, y = apply(pose, np.array(part.place)).tolist()
        turned = part.turned_deg + math.degrees(math.atan2(pose[0, 1], pose[0, 0]))
        return replace(part, ref=f"{position}/{part.ref}", place=(x, y), turned_deg=round(turned, 9))

    return tuple(moved(part, position, pose) for position, pose in poses.items() for part in parts)


def _given_parts(section: BoardSection, given: BoardType) -> tuple[Part, ...]:
    board, k = board_from_cad(section), MM_PER_UNIT[section.unit]
    spin = -1.0 if section.side == "bottom" else 1.0

    def part(component: Component) -> Part:
        x, y = apply(board, component.center)
        height = None if component.body_height is None else component.body_height * k
        package = package_of(component.ref, (component.width * k, component.height * k), height)
        body_height = 0.0 if component.fitted is False else round(package.body_height * section.height_scale, 4)
        part = Part(component.address, package, (float(x), float(y)), spin * component.rotation % 360, body_height)
        # A box that contains a fiducial is larger than its body, since the fiducial is in view.
        return replace(part, body_height_mm=0.0) if any(_covers(part, mark) for mark in section.marks) else part

    # Importers list fiducials as parts, too: the mark alone is drawn there.
    marks = [(f.x, f.y) for f in given.fiducials]
    bare = [c for c in given.components if min((math.dist(c.center, m) for m in marks), default=math.inf) * k > _AT_MM]
    return tuple(map(part, bare))


def _covers(part: Part, mark: FiducialMark) -> bool:
    """Return whether the box of a part reaches into a fiducial and the bare ring around it."""
    a, reach = math.radians(part.turned_deg), mark.diameter_mm
    x, y = mark.x_mm - part.place[0], mark.y_mm - part.place[1]
    u, v = math.cos(a) * x - math.sin(a) * y, math.sin(a) * x + math.cos(a) * y
    return abs(u) < part.package.size[0] / 2 + reach and abs(v) < part.package.size[1] / 2 + reach


class _PartPlacer:
    """Places the parts of one board. It holds the parts and the occupied rectangles so far."""

    def __init__(self, section: BoardSection) -> None:
        self.section = section
        self.size = (section.width_mm, section.length_mm)
        self.random = np.random.default_rng([section.seed, 7010])
        self.parts: list[Part] = []
        self.numbers: Counter[str] = Counter()
        self.taken = [(m.x_mm, m.y_mm, 1.6 * m.diameter_mm + 0.4, 1.6 * m.diameter_mm + 0.4) for m in section.marks] + [
            (*place, 2.6, 2.6) for place in mounting_holes(section)
        ]
        self.reserved = tuple(self.taken)

    def fill(self) -> tuple[Part, ...]:
        """Place all parts of the board and return them."""
        area_cm2 = self.section.width_mm * self.section.length_mm / 100
        wanted = round(self.section.density * area_cm2)
        for n in range(round(wanted * 0.09)):
            self._place_group(BIG[n % len(BIG)](), 1)
        for n in range(round(wanted * 0.14)):
            self._place_group(MIDDLE[n % len(MIDDLE)](), 1)
        # A dense board may not have room for all wanted parts, so the search ends after 40 failures.
        misses = 0
        while len(self.parts) < wanted and misses < 40:
            package = SMALL[int(self.random.integers(len(SMALL)))]()
            misses += not self._place_group(package, min(int(self.random.integers(2, 7)), wanted - len(self.parts)))
        return tuple(self.parts)

    def fill_grid(self, pitch_mm: float) -> tuple[Part, ...]:
        """Place equal parts on a square grid, wherever there is room, and return them."""
        package = light_emitting_diode()
        half = _half_extent(package, 0.0)
        least = [h + _EDGE_MM for h in half]
        for y in np.arange(least[1], self.size[1] - least[1], pitch_mm):
            for x in np.arange(least[0], self.size[0] - least[0], pitch_mm):
                place = round(float(x), 3), round(float(y), 3)
                # Parts may be closer to one another than those of other boards, but not to marks and holes.
                if self._clear_of_marks(place, half):
                    self._add_part(package, place, 0.0, half)
        return tuple(self.parts)

    def _place_group(self, package: Package, count: int) -> bool:
        """Place a group of equal parts side by side. Return False if no free position was found."""
        for _ in range(_TRIES):
            turned = 90.0 * int(self.random.integers(4))
            # A QFP that is not the first integrated circuit is rotated by 45°, so that boards also have diagonal leads.
            if package.name == "QFP-64" and self.numbers["U"] > 0:
                turned += 45.0
            half = _half_extent(package, turned)
            step = (0.0, 2 * half[1] + 0.5) if turned % 180 == 0 else (2 * half[0] + 0.5, 0.0)
            x, y = (self._random_coordinate(h, s) for h, s in zip(half, self.size, strict=True))
            places = [(round(x + n * step[0], 3), round(y + n * step[1], 3)) for n in range(count)]
            if all(self._free(place, half) for place in places):
                for place in places:
                    self._add_part(package, place, turned, half)
                return True
        return False

    def _random_coordinate(self, half: float, size: float) -> float:
        """Draw a coordinate for the centre of a part such that the part lies on the board, which ends at `size`."""
        least = half + _EDGE_MM
        return float(self.random.uniform(least, max(size - least, least)))

    def _free(self, place: tuple[float, float], half: tuple[float, float]) -> bool:
        """Return whether a part fits at a position, with clearance to other parts and to the edge of the board."""
        x, y = place
        inside = all(h + _EDGE_MM <= p <= s - h - _EDGE_MM for p, h, s in zip(place, half, self.size, strict=True))
        return inside and not any(
            abs(x - u) < half[0] + w + _GAP_MM and abs(y - v) < half[1] + h + _GAP_MM for u, v, w, h in self.taken
        )

    def _clear_of_marks(self, place: tuple[float, float], half: tuple[float, float]) -> bool:
        x, y = place
        return not any(abs(x - u) < half[0] + w and abs(y - v) < half[1] + h for u, v, w, h in self.reserved)

    def _add_part(self, package: Package, place: tuple[float, float], turned: float, half: tuple[float, float]) -> None:
        """Add a part. Its name is the prefix of its package with the next free number, such as R12."""
        self.numbers[package.prefix] += 1
        ref = f"{package.prefix}{self.numbers[package.prefix]}"
        height = round(package.body_height * self.section.height_scale, 4)
        self.parts.append(Part(ref, package, place, turned, height))
        self.taken.append((*place, *half))


def mounting_holes(section: BoardSection) -> tuple[tuple[float, float], ...]:
    """Return the centres of the mounting holes, mm, where the default fiducials leave room: two on large boards."""
    if min(section.width_mm, section.length_mm) < 45 or section.file is not None or section.panel is not None:
        return ()
    return (4.5, section.length_mm - 4.5), (section.width_mm / 2, 4.5)


def _half_extent(package: Package, turned_deg: float) -> tuple[float, float]:
    """Return half the width and half the height of the bounding box of a rotated footprint, mm."""
    a = math.radians(turned_deg)
    c, s = abs(math.cos(a)), abs(math.sin(a))
    w, h = package.size
    return (w * c + h * s) / 2, (w * s + h * c) / 2
