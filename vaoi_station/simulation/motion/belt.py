"""The position of a board at any time, on a belt whose speed and direction vary smoothly.

All variations are sums of sinusoids with random phases, drawn from the seed. So the distance travelled is an exact
integral, and positions can be computed for any time in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.scenario import BeltSection

_WAVES = 5
_SPREAD = 3.0
"""The periods of the sinusoids range from wander_period_s / 3 to wander_period_s · 3."""


@dataclass(frozen=True)
class Waves:
    """A sum of sinusoids a·sin(ω t + φ) with equal amplitudes a. Its root mean square over long times is 1."""

    omega: tuple[float, ...]
    phase: tuple[float, ...]
    amplitude = math.sqrt(2 / _WAVES)

    def value(self, t_s: float) -> float:
        """Return the sum at a time, s."""
        return self.amplitude * sum(math.sin(w * t_s + p) for w, p in zip(self.omega, self.phase, strict=True))

    def integral(self, t_s: float) -> float:
        """Return the integral of the sum from time 0 to `t_s`, s."""
        pairs = zip(self.omega, self.phase, strict=True)
        return self.amplitude * sum((math.cos(p) - math.cos(w * t_s + p)) / w for w, p in pairs)


@lru_cache(maxsize=64)
def waves(seed: int, purpose: int, period_s: float) -> Waves:
    """Return the waves of one varying quantity, its `purpose`; those of different quantities are independent."""
    g = np.random.default_rng([seed, 7001, purpose])
    periods = period_s * _SPREAD ** np.linspace(-1, 1, _WAVES) * g.uniform(0.9, 1.1, _WAVES)
    return Waves(tuple((2 * math.pi / periods).tolist()), tuple(g.uniform(0, 2 * math.pi, _WAVES).tolist()))


@dataclass(frozen=True)
class BoardMotion:
    """The motion of one board. Times are in seconds since the start of its passage."""

    belt: BeltSection
    start_s: float
    """Start of the passage, in seconds since the start of the scenario."""
    across_mm: float
    yaw_rad: float
    changes_from_s: float
    """Time from which the belt's changes of speed count."""
    start_along_mm: float = 0.0
    """Tester y of the board's centre at the start, times the direction of motion (+1 or −1)."""
    stop_s: float = math.inf
    """Time at which the board stops."""

    @classmethod
    def of(
        cls,
        belt: BeltSection,
        board_number: int,
        start_s: float,
        across_mm: float,
        turned_deg: int,
        changes_from_s: float,
    ) -> BoardMotion:
        """Return the motion of a board, whose random offset and rotation depend on seed and number only.

        `across_mm` is tester x of its centre before offsets, `turned_deg` its rotation counter-clockwise as the camera
        sees it (from tester y to tester x).
        """
        g = np.random.default_rng([belt.seed, 7002, board_number])
        offset, yaw = g.normal(0, belt.offset_sigma_mm), g.normal(0, belt.yaw_sigma_deg)
        yaw_rad = math.radians(belt.yaw_deg + float(yaw) - turned_deg)
        return cls(belt, start_s, across_mm + belt.offset_mm + float(offset), yaw_rad, changes_from_s)

    def pose(self, t_s: float, center_mm: tuple[float, float]) -> Floats:
        """Return tester_from_board (3, 3), a rigid transform, with the centre of the board in board coordinates."""
        x, y, angle = self.center(t_s)
        c, s = math.cos(angle), math.sin(angle)
        u, v = center_mm
        return np.array([[c, -s, x - c * u + s * v], [s, c, y - s * u - c * v], [0.0, 0.0, 1.0]])

    def belt_pose(self, t_s: float, follows: float) -> Floats:
        """Return the pose (3, 3), from the belt's texture to tester mm, of what moves `follows` times as the board.

        It moves on when a board gets stuck.
        """
        moving = replace(self, stop_s=math.inf)
        (x0, y0, a0), (x1, y1, a1) = moving.center(0.0), moving.center(t_s)
        x, y, a = x0 + follows * (x1 - x0), y0 + follows * (y1 - y0), a0 + follows * (a1 - a0)
        c, s = math.cos(a), math.sin(a)
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def center(self, t_s: float) -> tuple[float, float, float]:
        """Return tester x and y (mm) of the board's centre, and the rotation of the board (rad), at a time."""
        belt = self.belt
        # A board that gets stuck stops at once, while the belt below it moves on.
        t = self._belt_time_s(min(t_s, self.stop_s))
        now = self.start_s + t
        way = self._travelled_mm(now) - self._travelled_mm(self.start_s)
        sway, yaw = (waves(belt.seed, purpose, belt.wander_period_s).value(now) for purpose in (1, 2))
        skew = math.radians(belt.skew_deg)
        along = self.start_along_mm + way * math.cos(skew)
        across = self.across_mm + way * math.sin(skew) + belt.sway_mm * sway
        angle = self.yaw_rad + math.radians(belt.yaw_wander_deg) * yaw + math.radians(belt.yaw_rate_deg_s) * t
        return across, belt.direction * along, angle

    def _travelled_mm(self, t_s: float) -> float:
        """Return the distance that the belt has travelled since the start of the scenario."""
        belt = self.belt
        speed_mm_s = belt.speed_mm_s * (1 + belt.speed_error)
        return speed_mm_s * (t_s + belt.speed_wander * waves(belt.seed, 0, belt.wander_period_s).integral(t_s))

    def _belt_time_s(self, t_s: float) -> float:
        """Return the time that a belt at constant speed would need for the same distance.

        Everything that varies with the belt's motion depends on it: a board on a belt at rest does not sway.
        """
        t = t_s
        for change in self.belt.changes:
            begin = self.changes_from_s + change.at_s
            t -= (1 - change.factor) * min(max(t_s - begin, 0.0), change.for_s)
        return t
