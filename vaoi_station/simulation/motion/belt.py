"""Compute the position of a board at any time, on a belt whose speed and direction vary smoothly.

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

    @property
    def amplitude(self) -> float:
        """The amplitude a that all sinusoids of the sum have."""
        return math.sqrt(2 / len(self.omega))

    def value(self, t_s: float) -> float:
        """Return the sum of the sinusoids at the time `t_s`, s."""
        return self.amplitude * sum(math.sin(w * t_s + p) for w, p in zip(self.omega, self.phase, strict=True))

    def integral(self, t_s: float) -> float:
        """Return the integral of the sum of the sinusoids from time 0 to `t_s`, s."""
        pairs = zip(self.omega, self.phase, strict=True)
        return self.amplitude * sum((math.cos(p) - math.cos(w * t_s + p)) / w for w, p in pairs)


@lru_cache(maxsize=64)
def waves(seed: int, purpose: int, period_s: float) -> Waves:
    """Return the waves of one varying quantity. A different `purpose` per quantity makes the quantities independent."""
    g = np.random.default_rng([seed, 7001, purpose])
    periods = period_s * _SPREAD ** np.linspace(-1, 1, _WAVES) * g.uniform(0.9, 1.1, _WAVES)
    return Waves(tuple((2 * math.pi / periods).tolist()), tuple(g.uniform(0, 2 * math.pi, _WAVES).tolist()))


@dataclass(frozen=True)
class Belt:
    """The conveyor of a scenario. All times are in seconds since the start of the scenario."""

    section: BeltSection

    @property
    def true_speed_mm_s(self) -> float:
        """Mean speed: the nominal speed, increased by the relative speed error."""
        return self.section.speed_mm_s * (1 + self.section.speed_error)

    def travelled_mm(self, t_s: float) -> float:
        """Return the distance that the belt has travelled since time 0."""
        s = self.section
        return self.true_speed_mm_s * (t_s + s.speed_wander * waves(s.seed, 0, s.wander_period_s).integral(t_s))

    def speed_mm_s(self, t_s: float) -> float:
        """Return the speed of the belt at a time, mm/s."""
        s = self.section
        return self.true_speed_mm_s * (1 + s.speed_wander * waves(s.seed, 0, s.wander_period_s).value(t_s))

    def sway_mm(self, t_s: float) -> float:
        """Return by how much a board is displaced across the belt at a time, mm."""
        s = self.section
        return s.sway_mm * waves(s.seed, 1, s.wander_period_s).value(t_s)

    def yaw_rad(self, t_s: float) -> float:
        """Return the angle by which a board is turned on the belt at a time, rad, in addition to its fixed rotation."""
        s = self.section
        return math.radians(s.yaw_wander_deg) * waves(s.seed, 2, s.wander_period_s).value(t_s)


@dataclass(frozen=True)
class BoardMotion:
    """The motion of one board: position of its centre and rotation. Times are in seconds since the passage's start."""

    belt: Belt
    start_s: float
    """Start of the passage, in seconds since the start of the scenario."""
    start_along_mm: float
    """Tester y of the board's centre at the start, times the direction of motion (+1 or −1)."""
    across_mm: float
    yaw_rad: float
    stop_s: float = math.inf
    """Time at which the board stops, in seconds since the start of the passage; infinite if it does not stop."""
    changes_from_s: float = 0.0
    """Time from which the belt's changes of speed count, in seconds since the start of the passage."""

    def pose(self, t_s: float, center_mm: tuple[float, float]) -> Floats:
        """Return tester_from_board at a time: a rigid transform (3, 3) from board mm to tester mm.

        `center_mm` is the centre of the board in board coordinates.
        """
        x, y, angle = self.center(t_s)
        c, s = math.cos(angle), math.sin(angle)
        u, v = center_mm
        return np.array([[c, -s, x - c * u + s * v], [s, c, y - s * u - c * v], [0.0, 0.0, 1.0]])

    def belt_pose(self, t_s: float, follows: float) -> Floats:
        """Return the pose (3, 3), from coordinates of the belt's texture to tester mm, of what moves beside the board.

        Its motion is `follows` times that of the board: with 1 it moves like the board, with 0 it stands still. It
        moves on when a board gets stuck.
        """
        moving = replace(self, stop_s=math.inf)
        (x0, y0, a0), (x1, y1, a1) = moving.center(0.0), moving.center(t_s)
        x, y, a = x0 + follows * (x1 - x0), y0 + follows * (y1 - y0), a0 + follows * (a1 - a0)
        c, s = math.cos(a), math.sin(a)
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def center(self, t_s: float) -> tuple[float, float, float]:
        """Return tester x and y (mm) of the board's centre, and the rotation of the board (rad), at a time."""
        section = self.belt.section
        # A board that gets stuck stops at once, while the belt below it moves on.
        t = self._belt_time_s(min(t_s, self.stop_s))
        now = self.start_s + t
        way = self.belt.travelled_mm(now) - self.belt.travelled_mm(self.start_s)
        skew = math.radians(section.skew_deg)
        along = self.start_along_mm + way * math.cos(skew)
        across = self.across_mm + way * math.sin(skew) + self.belt.sway_mm(now)
        angle = self.yaw_rad + self.belt.yaw_rad(now) + math.radians(section.yaw_rate_deg_s) * t
        return across, section.direction * along, angle

    def _belt_time_s(self, t_s: float) -> float:
        """Return the time that a belt at constant speed would need for the same distance.

        Everything that varies with the belt's motion depends on this time. For example, a board on a belt at rest does
        not sway.
        """
        t = t_s
        for change in self.belt.section.changes:
            begin = self.changes_from_s + change.at_s
            t -= (1 - change.factor) * min(max(t_s - begin, 0.0), change.for_s)
        return t


def board_motion(
    section: BeltSection, board_number: int, *, start_s: float, start_along_mm: float, across_mm: float, turned_deg: int
) -> BoardMotion:
    """Return the motion of a board. Its random offset and rotation depend on the seed and the board number only.

    Args:
        section: the conveyor section of the scenario.
        board_number: number of the board, counted from 0.
        start_s: start of the passage, in seconds since the start of the scenario.
        start_along_mm: tester y of the board's centre at the start, times the direction of motion.
        across_mm: tester x of the board's centre before offsets.
        turned_deg: rotation of the board, counter-clockwise as the camera sees it (from tester y to tester x).
    """
    # There is one generator per board, so board k is the same regardless of how many boards pass before it.
    g = np.random.default_rng([section.seed, 7002, board_number])
    offset, yaw = g.normal(0, section.offset_sigma_mm), g.normal(0, section.yaw_sigma_deg)
    return BoardMotion(
        Belt(section),
        start_s,
        start_along_mm,
        across_mm + section.offset_mm + float(offset),
        math.radians(section.yaw_deg + float(yaw) - turned_deg),
    )
