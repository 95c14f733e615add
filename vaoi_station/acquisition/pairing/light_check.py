"""Compare with the light program what the controller or a replay reports of every pulse, and what frames state.

Pure logic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from vaoi_station.acquisition.cameras.interface import STATED_TOLERANCE_DB, StatedExposure, stated_tolerance_us
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse
from vaoi_station.model import ProgramRow
from vaoi_station.model.light_program import row_of

ON_TOLERANCE_US = 1.0
"""Accepted difference of an on-time or a width of the trigger, µs: the firmware rounds it to ticks of 0.5 µs."""
SHARE_TOLERANCE = 0.01
"""Accepted relative difference of a reported exposure or gain."""


def contradicted_rows(pulses: Mapping[int, ObservedPulse], program: Sequence[ProgramRow]) -> dict[int, str]:
    """Return {row: text} for the rows that were filmed otherwise than the program states; empty without a program."""
    found: dict[int, str] = {}
    for row, pulse in sorted(pulses.items()):
        expected = row_of(program, row)
        if expected is not None and (text := contradiction(pulse, expected)):
            found[row] = text
    return found


def contradiction(pulse: ObservedPulse, expected: ProgramRow) -> str:
    """Return what a pulse was reported with if the program states something else; an empty text otherwise."""
    if pulse.pulse.light != expected.light:
        lit = f"light {pulse.pulse.light!r}" if pulse.pulse.light else "no light"
        return f"its pulse was fired with {lit}, but the light program has {expected.light!r}"
    if pulse.on_us is not None and expected.on_us is not None and abs(pulse.on_us - expected.on_us) > ON_TOLERANCE_US:
        return (
            f"light {expected.light!r} was on for {pulse.on_us:g} µs, but the light program has {expected.on_us:g} µs"
        )
    is_us, must_us = pulse.trigger_us, expected.trigger_us
    if is_us is not None and must_us is not None and abs(is_us - must_us) > ON_TOLERANCE_US:
        return f"its trigger was high for {is_us:g} µs, but the light program has an exposure of {must_us:g} µs"
    for name, unit, reported, stated in (
        ("exposure", " µs", pulse.exposures_us, expected.lit_us),
        ("gain", "", pulse.gains, expected.gains),
    ):
        for camera, (is_, must) in enumerate(zip(reported, stated, strict=False)):
            if abs(is_ - must) > SHARE_TOLERANCE * must:
                return f"camera {camera} had {name} {is_:g}{unit}, but the light program has {must:g}{unit}"
    return ""


def contradicted_frames(camera: int, frames: Iterable[ObservedFrame], program: Sequence[ProgramRow]) -> dict[int, str]:
    """Return {row: text} for the frames of a camera that state another exposure or gain than the program."""
    if not program:
        return {}
    return {
        frame.row: text
        for frame in frames
        if frame.row is not None
        and frame.stated is not None
        and (text := _stated_contradiction(frame.stated, camera, frame.row, program))
    }


def _stated_contradiction(stated: StatedExposure, camera: int, row: int, program: Sequence[ProgramRow]) -> str:
    """Return what a frame states if the program has something else for its row; an empty text otherwise."""
    expected = program[row % len(program)]
    must_us, must_db = expected.exposures_us[camera], expected.gains_db[camera]
    # Steps are at least two tolerances apart in one of the two (`filming_plan`): a frame fits one step at most. What a
    # frame states may be no number (NaN), which is not below any limit.
    if not abs(stated.exposure_us - must_us) < stated_tolerance_us(must_us):
        return (
            f"its frame states an exposure of {stated.exposure_us:g} µs, but the light program has {must_us:g} µs: the "
            "camera's sequencer is at another row"
        )
    if stated.gain_db is not None and not abs(stated.gain_db - must_db) < STATED_TOLERANCE_DB:
        return (
            f"its frame states a gain of {stated.gain_db:g} dB, but the light program has {must_db:g} dB: the camera's "
            "sequencer is at another row"
        )
    return ""
