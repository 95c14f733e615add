"""Draw one recording at random: scenario, mistakes, and what is expected of the station by the rule of `rule.py`.

Equal seeds give equal drawings. Each subject has random numbers of its own, so that a further key of one does not
change the others; a further kind of mistake changes the drawings, and `FORM` counts such changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.hostile.mistakes import Mistake, Random, draw_beside, draw_mistakes, draw_moment, scenario_changes
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.scenario import Section

FORM = 1
"""Version of the generator. Seeds of finds are valid for one form only."""
FIRST_WITH_SURROUNDINGS = 10_000
"""First seed whose drawings also have a carrier, or texture beside the board; the seeds below stay as they were."""
FIRST_WITH_NEAR_COPIES = 87_000
"""First seed in whose drawings a frame may show another moment without being an exact copy."""
_WIDTH_PX, _HEIGHT_PX = 480, 360
_BARRIER_MM, _SPEED_MM_S = 40.0, 100.0


@dataclass(frozen=True)
class Drawing:
    """One drawing: the scenario with the mistakes that belong to it, and the mistakes themselves."""

    seed: int
    scenario: Scenario
    mistakes: tuple[Mistake, ...]

    def mistake(self, name: str) -> Mistake | None:
        """Return the mistake of this name, or None if the drawing does not have it."""
        return next((m for m in self.mistakes if m.name == name), None)


def draw(seed: int) -> Drawing:
    """Draw board, array, motion, light, faults and mistakes from a seed."""

    def numbers(subject: int) -> Random:
        return np.random.default_rng([seed, 9011, subject])

    array = _array(numbers(0))
    views = Scenario.model_validate({"array": array}).array
    board = _board(numbers(1), array, views.view_mm, views.pitch_mm)
    belt = _belt(numbers(3))
    # The barrier stands where boards come from.
    line = _line(numbers(2), views.view_mm[1], board["length_mm"]) | {"barrier_mm": -belt["direction"] * _BARRIER_MM}
    plain = {
        "array": array,
        "belt": belt,
        "board": board,
        "line": line,
        "lights": {"ring": _light(numbers(4))},
    }
    mistakes = draw_mistakes(numbers(5), array["cameras"])
    if seed >= FIRST_WITH_SURROUNDINGS:
        mistakes += draw_beside(numbers(6))
    if seed >= FIRST_WITH_NEAR_COPIES:
        mistakes += draw_moment(numbers(7), array["cameras"])
    scenario = Scenario.model_validate(plain)
    for mistake in mistakes:
        scenario = changed(scenario, scenario_changes(mistake, scenario))
    return Drawing(seed, scenario, mistakes)


def changed(scenario: Scenario, update: Mapping[str, Mapping[str, Any]]) -> Scenario:
    """Return a scenario with changed keys, by section; the values are checked as those of a file are."""
    document = scenario.model_dump()
    for section, values in update.items():
        assert isinstance(getattr(scenario, section), Section)
        document[section] = document[section] | dict(values)
    return Scenario.model_validate(document)


def _array(g: Random) -> dict[str, Any]:
    return {
        "seed": int(g.integers(1_000_000)),
        "width_px": _WIDTH_PX,
        "height_px": _HEIGHT_PX,
        "working_distance_mm": 300.0,
        "cameras": int(g.choice([1, 2, 2, 3])),
        "overlap": g.uniform(1.1, 1.3),
        "px_per_mm": g.uniform(14, 18),
        "gain": g.uniform(0.7, 1.05),
        "psf_px": g.uniform(0.5, 1.0),
        "read_noise": g.uniform(0.8, 2.5),
        "shot_noise": g.uniform(0.01, 0.05),
        "vignetting": g.uniform(0, 0.35),
        "flicker": g.uniform(0, 0.02),
    }


def _board(g: Random, array: dict[str, Any], view_mm: tuple[float, float], pitch_mm: float) -> dict[str, Any]:
    span = (array["cameras"] - 1) * pitch_mm + view_mm[0]
    # Every eighth board reaches out of view.
    width = round(span * (g.uniform(0.95, 1.1) if g.uniform() < 1 / 8 else g.uniform(0.7, 0.9)), 3)
    length = round(g.uniform(18, 32), 3)
    return {
        "name": "hostile",
        "seed": int(g.integers(1_000_000)),
        "width_mm": width,
        "length_mm": length,
        "density": g.uniform(0.8, 3),
        "lift_mm": g.normal(0, 0.2),
        "bow_mm": g.normal(0, 0.1),
        "tilt_mm": (g.normal(0, 0.04), g.normal(0, 0.04)),
        "y_axis": str(g.choice(["up", "down"])),
        "side": str(g.choice(["top", "bottom"])),
        "unit": str(g.choice(["mm", "inch", "mil"])),
        "fiducials": _fiducials(g, width, length),
    }


def _fiducials(g: Random, w: float, h: float) -> list[dict[str, Any]] | None:
    kind = g.choice(["three", "two", "symmetric", "one", "none"], p=[0.55, 0.25, 0.1, 0.05, 0.05])
    shape, d, inset = str(g.choice(["circle", "circle", "cross", "square", "diamond"])), 1.0, 3.0
    far = (w - inset, h - inset)
    near = (inset, inset) if kind in {"symmetric", "one"} else (inset + g.uniform(4, 8), inset + g.uniform(0, 3))
    places = {"none": [], "one": [near], "two": [near, far], "symmetric": [near, far]}.get(str(kind))
    if places is None:
        places = [near, far, (w - 1.6 * inset, 1.1 * inset)]
    return [{"x_mm": round(x, 3), "y_mm": round(y, 3), "diameter_mm": d, "shape": shape} for x, y in places]


def _belt(g: Random) -> dict[str, Any]:
    return {
        "seed": int(g.integers(1_000_000)),
        "speed_mm_s": _SPEED_MM_S,
        "direction": int(g.choice([1, -1])),
        "speed_error": g.normal(0, 0.008),
        "speed_wander": g.uniform(0, 0.015),
        "sway_mm": g.uniform(0, 0.08),
        "yaw_wander_deg": g.uniform(0, 0.06),
    }


def _line(g: Random, view_mm: float, length_mm: float) -> dict[str, Any]:
    """Draw the timing: the board enters and leaves the view along the motion, with a drawn number of rows."""
    into, left = g.uniform(0.05, 0.35) * view_mm, g.uniform(0.05, 0.4) * view_mm
    return {
        "start_delay_s": (_BARRIER_MM - view_mm / 2 + into) / _SPEED_MM_S,
        "tail_s": (_BARRIER_MM + view_mm / 2 - left) / _SPEED_MM_S,
        "period_s": view_mm / g.uniform(1.6, 3) / _SPEED_MM_S,
        "longest_board_mm": 1.3 * length_mm,
    }


def _light(g: Random) -> dict[str, Any]:
    return {"azimuth_deg": g.uniform(-180, 180), "shading": g.uniform(0, 0.25), "shadow": g.uniform(0, 0.35)}
