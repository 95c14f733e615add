"""What is wrong with a light program: every fault at once, with step, key and camera for a form that shows it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from vaoi_station.acquisition.cameras.interface import (
    EXPOSURE_TOLERANCE,
    EXPOSURE_TOLERANCE_US,
    GAIN_TOLERANCE_DB,
    CameraExposure,
    CameraLimits,
)
from vaoi_station.errors import InputError
from vaoi_station.model import ProgramRow
from vaoi_station.model.note import Note

OF_PROGRAM = ("trigger plan", "program.{step}.")
"""What states the values of a light program, and what precedes the name of a field, in messages."""

MOST_SHOWN = 5
"""Largest number of faults that the message of one error names."""


@dataclass(frozen=True)
class ProgramFault:
    """One fault of a light program, or of the line on which it would run."""

    error: InputError
    step: int | None = None
    """Index of the step; None if the fault concerns the whole program or the line."""
    key: str = ""
    """The key of the step that is wrong; empty if it is none of them."""
    camera: int | None = None


def coded(error: InputError, *, code: str, **values: object) -> InputError:
    """Return an error whose message has a code and the values that it states, for texts in other languages."""
    error.message = Note(code, error.message, **values)
    return error


def require_none(faults: Sequence[ProgramFault]) -> None:
    """Raise one InputError that names all faults, at most `MOST_SHOWN` of them; return if there are none."""
    if len(faults) == 1:
        raise faults[0].error
    if faults:
        # Several cameras often have the same fault with different numbers; a person corrects the first ones first.
        messages = list(dict.fromkeys(fault.error.message for fault in faults))
        more = len(messages) - MOST_SHOWN
        shown = " ".join(messages[:MOST_SHOWN]) + (f" And {more} more." if more > 0 else "")
        raise InputError(shown, action=next((f.error.action for f in faults if f.error.action), ""))


def unknown_lights(program: Sequence[ProgramRow], lights: Collection[str]) -> list[ProgramFault]:
    """Return a fault for each step with a light that a simulated line does not have."""
    limit = f"a light of the scenario, which has {', '.join(map(repr, lights))}"
    faults = []
    for n, row in enumerate(program):
        if row.light not in lights:
            error = InputError.field("trigger plan", f"program.{n}.light", row.light, limit)
            coded(error, code="unknown-light", light=row.light, known=", ".join(lights))
            faults.append(ProgramFault(error, n, "light"))
    return faults


def beyond_camera(
    wanted: CameraExposure,
    gains_db: Sequence[float],
    limits: CameraLimits,
    camera: int,
    label: str,
    names: tuple[str, str] = OF_PROGRAM,
) -> Iterator[ProgramFault]:
    """Yield what a camera refuses of its exposures and gains when the line is armed, with the limits it has stated.

    Args:
        wanted: how the camera is to expose the rows.
        gains_db: its gain in each step.
        limits: what the camera has stated.
        camera: its number.
        label: its name in messages.
        names: what states the values, and what precedes the name of a field, in messages; by default the steps of a
            program.
    """
    if len(wanted.sequence) > (limits.sets or 0):
        limit = f"at most {limits.sets}, the sets of the sequencer of {label}"
        if limits.sets is None:
            limit = f'1: {label} has no sequencer, though its exposure_by in station.toml is "sequencer"'
        action, count = "Let the on-time of the LEDs (on_us) make the difference between rows.", len(wanted.sequence)
        error = InputError.field("trigger plan", "number of different steps", count, limit, action)
        coded(error, code="sequencer-too-short", camera=label, count=count, most=limits.sets or 0)
        yield ProgramFault(error, camera=camera)
    # The sets of a sequencer are compared exactly; a register is read back, and a camera may have rounded it.
    exact = bool(wanted.sequence)
    values = [("exposure_us", "µs", wanted.exposures_us, limits.exposure_us, exact)] if not wanted.by_trigger else []
    for key, unit, steps, bounds, exactly in (*values, ("gain_db", "dB", tuple(gains_db), limits.gain_db, exact)):
        for n, value in enumerate(steps):
            near = max(EXPOSURE_TOLERANCE_US, EXPOSURE_TOLERANCE * value) if unit == "µs" else GAIN_TOLERANCE_DB
            spare = 0.0 if exactly else near
            if bounds is not None and not bounds[0] - spare <= value <= bounds[1] + spare:
                limit = f"{bounds[0]:g} … {bounds[1]:g} {unit}, the limits that {label} states"
                field = names[1].format(step=n) + key
                error = InputError.field(names[0], field, value, limit)
                given = {"value": f"{value:g} {unit}", "low": f"{bounds[0]:g}", "high": f"{bounds[1]:g} {unit}"}
                coded(error, code="beyond-camera", camera=label, field=key, **given)
                yield ProgramFault(error, n, key, camera) if names == OF_PROGRAM else ProgramFault(error, camera=camera)
