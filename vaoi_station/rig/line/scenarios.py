"""Adapt a scenario to the rig: number of cameras, LED channels of its lights, shortest interval between boards."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vaoi_station.errors import InputError
from vaoi_station.rig.devices.pulses import CHANNELS
from vaoi_station.rig.line.faults import KINDS
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.virtual_line import Lighting
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.world import program_of

_SIMULATED_CAMERA_FAULTS = (
    "late_frames", "incomplete_frames", "ignored_triggers", "extra_frames", "exchanged_frames", "free_running",
    "late_stamps",
)  # fmt: skip


def with_cameras(scenario: Scenario, count: int | None) -> Scenario:
    """Return the scenario with `count` cameras and a board as wide as they can see; unchanged if `count` is None."""
    array = scenario.array
    if count is None or count == array.cameras:
        return scenario
    width_mm = scenario.board.width_mm + (count - array.cameras) * array.pitch_mm
    if width_mm < 8:
        raise InputError.field("vaoi rig", "--cameras", count, "enough to see a board of 8 mm")
    board = scenario.board.model_copy(update={"width_mm": round(width_mm, 3), "name": f"{scenario.board.name}-{count}"})
    return scenario.model_copy(update={"array": array.model_copy(update={"cameras": count}), "board": board})


def check_supported(scenario: Scenario) -> None:
    """Raise InputError if the scenario contains camera faults; on the rig, `--fault` injects such faults."""
    for name in _SIMULATED_CAMERA_FAULTS:
        if getattr(scenario.faults, name):
            action = f"Take them out, and ask for {', '.join(KINDS)} by --fault."
            raise InputError(
                f"scenario: faults.{name} apply to the cameras of the in-process twin only.", action=action
            )


def lighting_of(scenario: Scenario) -> Lighting:
    """Assign one LED channel to each light of the scenario.

    Raises:
        InputError: the scenario has more lights than the controller has channels.
    """
    program = program_of(scenario)
    names = tuple(dict.fromkeys(row.light for row in program)) or tuple(dict.fromkeys(scenario.line.lights))
    if len(names) > len(CHANNELS):
        key = "program" if program else "line.lights"
        raise InputError.field("scenario", f"lights of {key}", names, f"at most {len(CHANNELS)} different ones")
    exposures_us = tuple(scenario.array.exposure_us(n) for n in range(scenario.array.cameras))
    return Lighting({name: (n,) for n, name in enumerate(names)}, exposures_us, program)


def min_interval_s(scenario: Scenario, boards: Sequence[RenderedBoard]) -> float:
    """Return the shortest interval between boards, s: one must have passed, and its bay be free, before the next."""
    # 0.8 s are for the result and the release of the bay. The sum is rounded up to a tenth of a second.
    return max(scenario.line.interval_s, math.ceil(10 * (max(b.duration_s for b in boards) + 0.8)) / 10)
