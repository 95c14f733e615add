"""Compare what the controller or a replay reports of every pulse with the light program of the run. Pure logic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vaoi_station.acquisition.pairing.run_record import ObservedPulse
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
