"""Where the board is at a time: a belt whose speed and direction wander smoothly.

All wanderings are sums of sinusoids with phases drawn from the seed, so that the way travelled is an
exact integral and any time can be asked for in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.scenario import BeltSection

_WAVES = 5
_SPREAD = 3.0
"""Periods reach from wander_period / 3 to wander_period · 3."""


@dataclass(frozen=True)
class Waves:
    """Σ a·sin(ω t + φ) of unit root mean square over long times."""

    omega: tuple[float, ...]
    phase: tuple[float, ...]

    @property
    def amplitude(self) -> float:
        """Amplitude of each sinusoid."""
        return math.sqrt(2 / len(self.omega))

    def value(self, t_s: float) -> float:
        """The wandering quantity at a time."""
        return self.amplitude * sum(math.sin(w * t_s + p) for w, p in zip(self.omega, self.phase, strict=True))

    def integral(self, t_s: float) -> float:
        """Its integral from time 0."""
        pairs = zip(self.omega, self.phase, strict=True)
        return self.amplitude * sum((math.cos(p) - math.cos(w * t_s + p)) / w for w, p in pairs)


@lru_cache(maxsize=64)
def waves(seed: int, purpose: int, period_s: float) -> Waves:
    """The waves of one wandering quantity; `purpose` keeps quantities apart."""
    g = np.random.default_rng([seed, 7001, purpose])
    periods = period_s * _SPREAD ** np.linspace(-1, 1, _WAVES) * g.uniform(0.9, 1.1, _WAVES)
    return Waves(tuple((2 * math.pi / periods).tolist()), tuple(g.uniform(0, 2 * math.pi, _WAVES).tolist()))


@dataclass(frozen=True)
class Belt:
    """The conveyor of a scenario; times are seconds since the scenario's start."""

    section: BeltSection

    @property
    def true_speed_mm_s(self) -> float:
        """Mean speed, nominal speed and its error together."""
        return self.section.speed_mm_s * (1 + self.section.speed_error)

    def way_mm(self, t_s: float) -> float:
        """Way travelled along the motion since time 0."""
        s = self.section
        return self.true_speed_mm_s * (t_s + s.speed_wander * waves(s.seed, 0, s.wander_period_s).integral(t_s))

    def speed_mm_s(self, t_s: float) -> float:
        """Speed along the motion at a time."""
        s = self.section
        return self.true_speed_mm_s * (1 + s.speed_wander * waves(s.seed, 0, s.wander_period_s).value(t_s))

    def sway_mm(self, t_s: float) -> float:
        """Wandering across the motion."""
        s = self.section
        return s.sway_mm * waves(s.seed, 1, s.wander_period_s).value(t_s)

    def yaw_rad(self, t_s: float) -> float:
        """Wandering rotation."""
        s = self.section
        return math.radians(s.yaw_wander_deg) * waves(s.seed, 2, s.wander_period_s).value(t_s)


@dataclass(frozen=True)
class Course:
    """The way of one board: its middle's place and its rotation at times since the passage's start."""

    belt: Belt
    start_s: float
    """Time of the passage's start since the scenario's start."""
    start_along_mm: float
    """Tester coordinate of the board's middle at the start, times the direction of motion."""
    across_mm: float
    yaw_rad: float
    stop_s: float = math.inf
    """When the board sticks, since the passage's start."""

    def pose(self, t_s: float, middle_mm: tuple[float, float]) -> Floats:
        """tester_from_board, (3, 3) Euclidean; `middle_mm` is the board's middle in board coordinates."""
        x, y, angle = self.middle(t_s)
        c, s = math.cos(angle), math.sin(angle)
        u, v = middle_mm
        return np.array([[c, -s, x - c * u + s * v], [s, c, y - s * u - c * v], [0.0, 0.0, 1.0]])

    def middle(self, t_s: float) -> tuple[float, float, float]:
        """Tester x, y (mm) of the board's middle, and its rotation (rad)."""
        section = self.belt.section
        t = min(t_s, self.stop_s)
        now = self.start_s + t
        way = self.belt.way_mm(now) - self.belt.way_mm(self.start_s)
        skew = math.radians(section.skew_deg)
        along = self.start_along_mm + way * math.cos(skew)
        across = self.across_mm + way * math.sin(skew) + self.belt.sway_mm(now)
        angle = self.yaw_rad + self.belt.yaw_rad(now) + math.radians(section.yaw_rate_deg_s) * t
        return across, section.direction * along, angle


def course(
    section: BeltSection, board_number: int, *, start_s: float, start_along_mm: float, across_mm: float, turned_deg: int
) -> Course:
    """The way of board `board_number`; its offset and rotation on the belt follow from seed and number.

    `turned_deg` counts counter-clockwise as the camera sees it, from tester y to tester x.
    """
    g = np.random.default_rng([section.seed, 7002, board_number])
    offset, yaw = g.normal(0, section.offset_sigma_mm), g.normal(0, section.yaw_sigma_deg)
    return Course(
        Belt(section),
        start_s,
        start_along_mm,
        across_mm + section.offset_mm + float(offset),
        math.radians(section.yaw_deg + float(yaw) - turned_deg),
    )
