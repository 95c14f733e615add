"""Compute where the board is at a time: a belt whose speed and direction vary smoothly.

All variations are sums of sinusoids with phases drawn from the seed. So the distance travelled is an exact integral,
and any time can be requested in any order.
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
"""Periods range from wander_period / 3 to wander_period · 3."""


@dataclass(frozen=True)
class Waves:
    """Σ a·sin(ω t + φ) with a root mean square of 1 over long times."""

    omega: tuple[float, ...]
    phase: tuple[float, ...]

    @property
    def amplitude(self) -> float:
        """Amplitude of each sinusoid."""
        return math.sqrt(2 / len(self.omega))

    def value(self, t_s: float) -> float:
        """Return the sum at a time."""
        return self.amplitude * sum(math.sin(w * t_s + p) for w, p in zip(self.omega, self.phase, strict=True))

    def integral(self, t_s: float) -> float:
        """Return its integral from time 0."""
        pairs = zip(self.omega, self.phase, strict=True)
        return self.amplitude * sum((math.cos(p) - math.cos(w * t_s + p)) / w for w, p in pairs)


@lru_cache(maxsize=64)
def waves(seed: int, purpose: int, period_s: float) -> Waves:
    """Return the waves of one varying quantity; `purpose` keeps quantities independent."""
    g = np.random.default_rng([seed, 7001, purpose])
    periods = period_s * _SPREAD ** np.linspace(-1, 1, _WAVES) * g.uniform(0.9, 1.1, _WAVES)
    return Waves(tuple((2 * math.pi / periods).tolist()), tuple(g.uniform(0, 2 * math.pi, _WAVES).tolist()))


@dataclass(frozen=True)
class Belt:
    """The conveyor of a scenario; times are seconds since the start of the scenario."""

    section: BeltSection

    @property
    def true_speed_mm_s(self) -> float:
        """Mean speed: the nominal speed with its error."""
        return self.section.speed_mm_s * (1 + self.section.speed_error)

    def travelled_mm(self, t_s: float) -> float:
        """Return the distance travelled along the motion since time 0."""
        s = self.section
        return self.true_speed_mm_s * (t_s + s.speed_wander * waves(s.seed, 0, s.wander_period_s).integral(t_s))

    def speed_mm_s(self, t_s: float) -> float:
        """Return the speed along the motion at a time."""
        s = self.section
        return self.true_speed_mm_s * (1 + s.speed_wander * waves(s.seed, 0, s.wander_period_s).value(t_s))

    def sway_mm(self, t_s: float) -> float:
        """Return the deviation across the motion at a time."""
        s = self.section
        return s.sway_mm * waves(s.seed, 1, s.wander_period_s).value(t_s)

    def yaw_rad(self, t_s: float) -> float:
        """Return the deviation of the rotation at a time."""
        s = self.section
        return math.radians(s.yaw_wander_deg) * waves(s.seed, 2, s.wander_period_s).value(t_s)


@dataclass(frozen=True)
class BoardMotion:
    """The motion of one board: position and rotation of its centre at times since the start of the passage."""

    belt: Belt
    start_s: float
    """Start of the passage since the start of the scenario."""
    start_along_mm: float
    """Tester coordinate of the board's centre at the start, times the direction of motion."""
    across_mm: float
    yaw_rad: float
    stop_s: float = math.inf
    """Time at which the board sticks, since the start of the passage."""

    def pose(self, t_s: float, center_mm: tuple[float, float]) -> Floats:
        """Return tester_from_board, (3, 3) Euclidean; `center_mm` is the board's centre in board coordinates."""
        x, y, angle = self.center(t_s)
        c, s = math.cos(angle), math.sin(angle)
        u, v = center_mm
        return np.array([[c, -s, x - c * u + s * v], [s, c, y - s * u - c * v], [0.0, 0.0, 1.0]])

    def center(self, t_s: float) -> tuple[float, float, float]:
        """Return tester x, y (mm) of the board's centre, and its rotation (rad)."""
        section = self.belt.section
        # A board that sticks stops at once; the belt below it goes on.
        t = min(t_s, self.stop_s)
        now = self.start_s + t
        way = self.belt.travelled_mm(now) - self.belt.travelled_mm(self.start_s)
        skew = math.radians(section.skew_deg)
        along = self.start_along_mm + way * math.cos(skew)
        across = self.across_mm + way * math.sin(skew) + self.belt.sway_mm(now)
        angle = self.yaw_rad + self.belt.yaw_rad(now) + math.radians(section.yaw_rate_deg_s) * t
        return across, section.direction * along, angle


def board_motion(
    section: BeltSection, board_number: int, *, start_s: float, start_along_mm: float, across_mm: float, turned_deg: int
) -> BoardMotion:
    """Return the motion of board `board_number`; seed and number give its offset and rotation on the belt.

    `turned_deg` is counter-clockwise as the camera sees it, from tester y to tester x.
    """
    # One generator per board: board k is the same however many boards pass before it.
    g = np.random.default_rng([section.seed, 7002, board_number])
    offset, yaw = g.normal(0, section.offset_sigma_mm), g.normal(0, section.yaw_sigma_deg)
    return BoardMotion(
        Belt(section),
        start_s,
        start_along_mm,
        across_mm + section.offset_mm + float(offset),
        math.radians(section.yaw_deg + float(yaw) - turned_deg),
    )
