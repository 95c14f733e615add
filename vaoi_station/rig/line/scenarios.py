"""What follows from a scenario: its array made larger, its lights on LED channels, how soon boards may follow."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vaoi_station.errors import InputError
from vaoi_station.rig.devices.pins import CHANNELS
from vaoi_station.rig.line.faults import KINDS
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.stage import Lamp
from vaoi_station.simulation import Scenario

_OF_SIMULATED_CAMERAS = (
    "late_frames", "incomplete_frames", "ignored_triggers", "extra_frames", "exchanged_frames", "free_running",
)  # fmt: skip


def with_cameras(scenario: Scenario, count: int | None) -> Scenario:
    """The scenario with more or fewer cameras, and a board as much wider or narrower."""
    array = scenario.array
    if count is None or count == array.cameras:
        return scenario
    width_mm = scenario.board.width_mm + (count - array.cameras) * array.pitch_mm
    if width_mm < 8:
        raise InputError.field("vaoi rig", "--cameras", count, "enough to see a board of 8 mm")
    board = scenario.board.model_copy(update={"width_mm": round(width_mm, 3), "name": f"{scenario.board.name}-{count}"})
    return scenario.model_copy(update={"array": array.model_copy(update={"cameras": count}), "board": board})


def check_playable(scenario: Scenario) -> None:
    """InputError for a scenario whose cameras themselves do wrong: here that is asked for by `--fault`."""
    for name in _OF_SIMULATED_CAMERAS:
        if getattr(scenario.faults, name):
            action = f"Take them out, and ask for {', '.join(KINDS)} by --fault."
            raise InputError(f"scenario: faults.{name} befall the cameras of the in-process twin only.", action=action)


def lamp_of(scenario: Scenario) -> Lamp:
    """Every light of the scenario on a channel of its own, lit for the longest exposure.

    Raises:
        InputError: more lights than channels.
    """
    names = tuple(dict.fromkeys(scenario.line.lights))
    if len(names) > len(CHANNELS):
        raise InputError.field("scenario", "line.lights", names, f"at most {len(CHANNELS)} different ones")
    exposures_us = tuple(scenario.array.exposure_us(n) for n in range(scenario.array.cameras))
    return Lamp({name: (n,) for n, name in enumerate(names)}, exposures_us)


def least_interval_s(scenario: Scenario, films: Sequence[Film]) -> float:
    """Boards come no faster than one passes, is told of and makes room."""
    return max(scenario.line.interval_s, math.ceil(10 * (max(f.lasts_s for f in films) + 0.8)) / 10)
