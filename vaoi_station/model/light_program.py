"""A light program: light, exposure and gain of every row, in steps that repeat over the rows of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from vaoi_station.model.frozen_model import FrozenModel, Positive

MOST_STEPS = 64
"""Largest number of steps of a program. The controller's firmware may hold fewer; it says how many."""


def _as_tuple(value: Any) -> Any:
    """Return a single number, which applies to all cameras, as a list with one entry."""
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


_Microseconds = Annotated[Positive, Field(le=1e6)]
_Decibels = Annotated[float, Field(strict=True, ge=-60, le=60, allow_inf_nan=False)]


class ProgramStep(FrozenModel):
    """One step of a program as a board type or station.toml states it. What is absent is as in station.toml."""

    light: Annotated[str, Field(min_length=1, max_length=100)]
    """Name of the light pattern."""
    on_us: _Microseconds | None = None
    """On-time of the light's LEDs, µs."""
    exposure_us: Annotated[tuple[_Microseconds, ...], Field(min_length=1), BeforeValidator(_as_tuple)] | None = None
    """Exposure of every camera, µs; one entry applies to all cameras."""
    gain_db: Annotated[tuple[_Decibels, ...], Field(min_length=1), BeforeValidator(_as_tuple)] | None = None
    """Gain of every camera, dB; one entry applies to all cameras."""


Program = Annotated[tuple[ProgramStep, ...], Field(max_length=MOST_STEPS)]
"""The steps of a light program: row j is filmed with step j modulo their number. Empty: there is no program."""


@dataclass(frozen=True)
class ProgramRow:
    """One step of a program with all its values: what a row is filmed with."""

    light: str
    exposures_us: tuple[float, ...]
    """Exposure of every camera, µs: the time for which its shutter is open."""
    gains_db: tuple[float, ...]
    on_us: float | None = None
    """On-time of the LEDs, µs; None if the light shines for the whole exposure."""
    trigger_us: float | None = None
    """Width of the camera trigger, µs, where cameras expose for as long; None: that of station.toml."""

    @property
    def lit_us(self) -> tuple[float, ...]:
        """Time for which light falls on the sensor of every camera, µs: the shorter of exposure and on-time."""
        return self.exposures_us if self.on_us is None else tuple(min(e, self.on_us) for e in self.exposures_us)

    @property
    def gains(self) -> tuple[float, ...]:
        """Linear gain of every camera; 1 is 0 dB."""
        return tuple(linear_gain(db) for db in self.gains_db)


def linear_gain(gain_db: float) -> float:
    """Convert a gain in dB to the factor on grey levels, rounded to 6 decimals."""
    return round(10 ** (gain_db / 20), 6)


def row_of(program: Sequence[ProgramRow], row: int) -> ProgramRow | None:
    """Return what a row is filmed with; None without a program."""
    return program[row % len(program)] if program else None


def usual_light(lights: Iterable[str | None]) -> str | None:
    """Return the light of most frames, and of equally many the first; None if there is no frame."""
    return next(iter(Counter(lights).most_common(1)), (None, 0))[0]
