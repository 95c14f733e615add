"""Translate a trigger plan, with its light program or the lights of station.toml, into the firmware's configuration.

Values beyond the firmware's limits are refused here, in the units of `station.toml`. A refusal by the firmware itself
is translated back into these units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass

from vaoi_station.acquisition.controller.filming_plan import ProgramFault, refusal, require_none
from vaoi_station.acquisition.controller.interface import FirmwareLimits, TriggerPlan
from vaoi_station.acquisition.controller.protocol import (
    FIRST_STEP,
    TICK_S,
    Ident,
    Nak,
    Pacing,
    Reason,
    Request,
    Step,
    Timing,
    Type,
    config_crc,
    configuration,
)
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import InputError

DARK = Step(0, 0)
_WHERE = "station.toml"
_PLAN = "trigger plan"
_FIELDS = {
    2: (_PLAN, "max_rows", 1),
    3: (_PLAN, "start_delay_s", TICK_S),
    4: (_PLAN, "period_s", TICK_S),
    5: (_PLAN, "tail_s", TICK_S),
    6: (_PLAN, "period_s", TICK_S),
    7: (_PLAN, "debounce_s", TICK_S),
    8: (_WHERE, "controller.min_gap_s", TICK_S),
    9: (_WHERE, "controller.trigger_us", TICK_S * 1e6),
}
"""For each field of a refused COMMIT: the file or plan that states it, its name there, and the size of its unit."""
_DISTANCES = (3, 4, 5)
"""Those fields that are counts of the encoder if it spaces the rows."""
_NARROWEST, _CLEARANCE = 100, 6000
"""Shortest width of the trigger, and time from its end to the next row, in ticks (hw/protocol.md)."""
_SHORT_FIELDS = (2, 9)
"""Those fields that have 16 bits; the others have 32."""


@dataclass(frozen=True)
class DeviceProgram:
    """A configuration of the firmware, with the name of the light that each of its steps belongs to."""

    timing: Timing
    steps: tuple[Step, ...]
    lights: tuple[str, ...]
    widths: tuple[int, ...] = ()
    """Width of the trigger of each step, in ticks; empty if all have that of `timing`."""
    known: tuple[tuple[str, int], ...] = ()

    @property
    def crc(self) -> int:
        """The checksum by which the firmware identifies this configuration."""
        return config_crc(self.timing, self.steps, self.widths)

    def requests(self) -> list[Request]:
        """Return the requests that set and activate this configuration."""
        return configuration(self.timing, self.steps, self.widths)

    def light(self, row: int) -> str:
        """Return the name of a row's light; an empty text if the lights have no names."""
        return self.lights[row % len(self.lights)] if self.lights else ""

    def lit(self, row: int, channels: int) -> str:
        """Return the name of the light of these LED channels (bits), which the controller lit for a row."""
        if not channels:
            return ""
        # Several lights may have the same channels. The one that the program has for the row comes first.
        candidates = ((self.light(row), self.steps[row % len(self.steps)].channels), *self.known)
        numbers = "+".join(str(k) for k in range(channels.bit_length()) if channels >> k & 1)
        return next((name for name, bits in candidates if bits == channels and name), f"LED channels {numbers}")


def firmware_limits(ident: Ident) -> FirmwareLimits:
    """Return the limits that the firmware states for a light program."""
    return FirmwareLimits(
        version=ident.firmware,
        steps=ident.program_steps,
        channels=ident.channels,
        shortest_us=_us(ident.led_shortest),
        longest_us=tuple(_us(ticks) for ticks in ident.led_longest),
        share=1 << ident.led_duty_shift,
        widest_us=_us(ident.trigger_longest),
    )


def make_program(plan: TriggerPlan, config: ControllerConfig, ident: Ident) -> DeviceProgram:
    """Translate a plan; raise InputError if the firmware cannot carry it out."""
    limits = firmware_limits(ident)
    require_none(program_faults(plan, config, limits))
    lights = tuple(plan.lights) or config.light_sequence
    steps = tuple(_step(plan, config, limits, n, name) for n, name in enumerate(lights)) or (DARK,)
    belt = plan.belt
    values = (
        Pacing.TIME if belt is None else Pacing.DISTANCE,
        len(steps),
        plan.max_rows,
        _ticks(plan.start_delay_s) if belt is None else belt.start,
        _ticks(plan.period_s) if belt is None else belt.row,
        _ticks(plan.tail_s) if belt is None else belt.tail,
        _ticks(plan.shortest_period_s),
        _ticks(plan.debounce_s),
        _ticks(config.min_gap_s),
        _ticks(config.trigger_us * 1e-6),
    )
    # Values that do not fit are sent as the largest number. The firmware then refuses them with its own limit.
    timing = Timing(*(min(v, 0xFFFF if k in _SHORT_FIELDS else 0xFFFFFFFF) for k, v in enumerate(values)))
    known = tuple((name, _mask(light)) for name, light in config.lights.items())
    widths = tuple(_ticks(row.trigger_us * 1e-6) for row in plan.program if row.trigger_us is not None)
    return DeviceProgram(timing, steps, lights, widths if plan.by_trigger else (), known)


def program_faults(plan: TriggerPlan, config: ControllerConfig, limits: FirmwareLimits) -> list[ProgramFault]:
    """Return every fault of a plan's lights that `make_program` would refuse."""
    lights = tuple(plan.lights) or config.light_sequence
    faults = []
    if (count := len(lights)) > (most := limits.steps):
        stated: tuple[str, str, object, str]
        stated = (_WHERE, "controller.order", lights, f"at most {most} lights, the steps of the firmware's program")
        if plan.program:
            limit = f"at most {most}, the steps that the controller's firmware holds"
            stated = (_PLAN, "number of steps of the light program", count, limit)
        faults.append(ProgramFault(refusal(*stated, code="too-many-steps", count=count, most=most)))
    for n, name in enumerate(lights):
        try:
            _step(plan, config, limits, n, name)
        except InputError as error:
            key = "on_us" if name in config.lights else "light"
            faults.append(ProgramFault(error, n, key) if plan.program else ProgramFault(error))
    return [*faults, *_width_faults(plan, limits)]


def _step(plan: TriggerPlan, config: ControllerConfig, limits: FirmwareLimits, number: int, light: str) -> Step:
    on_us = plan.program[number].on_us if plan.program else None
    return light_step(light, config, limits, plan.shortest_period_s, on_us)


def _width_faults(plan: TriggerPlan, limits: FirmwareLimits) -> Iterator[ProgramFault]:
    if not plan.by_trigger:
        return
    if not limits.widest_us:
        exposures = ", ".join(f"{row.trigger_us:g}" for row in plan.program)
        limit = f"one for all rows: firmware {limits.version} has one width of the trigger, from 1.3.0 on one per row"
        code = "one-width-for-all-rows"
        key = "exposures by the width of the trigger"
        error = refusal(_PLAN, key, f"{exposures} µs", limit, code=code, version=limits.version)
        yield ProgramFault(error, key="exposure_us")
        return
    # The trigger must have fallen before the next row is prepared.
    spare = _ticks(plan.shortest_period_s) - _CLEARANCE
    bounds = {
        _ticks(limits.widest_us * 1e-6): "the longest trigger of its firmware",
        spare: f"the period of {plan.shortest_period_s:g} s less 3 ms",
    }
    most = min(bounds)
    low, high = f"{_us(_NARROWEST):g}", f"{_us(most):g}"
    for n, row in enumerate(plan.program):
        assert row.trigger_us is not None
        width = _ticks(row.trigger_us * 1e-6)
        if not _NARROWEST <= width <= most:
            why = bounds[most] if width > most else "the shortest trigger of its firmware"
            limit = f"{low} … {high} where the trigger's width sets it ({why})"
            bound = {"value": f"{row.trigger_us:g}", "low": low, "high": high}
            key = f"program.{n}.exposure_us"
            error = refusal(_PLAN, key, row.trigger_us, limit, code="trigger-width-beyond", **bound)
            yield ProgramFault(error, n, "exposure_us")


def on_limits_us(
    name: str, config: ControllerConfig, limits: FirmwareLimits, period_s: float | None = None
) -> tuple[float, float, str]:
    """Return the shortest and the longest on-time of a light, µs, and which limit the longest one is.

    The limit of the duty cycle counts only if `period_s` is given.
    """
    light = config.lights[name]
    if beyond := [c for c in light.channels if c >= limits.channels]:
        limit = f"below {limits.channels}, the number of LED channels"
        values = {"light": name, "channel": beyond[0], "channels": limits.channels}
        key = f"controller.lights.{name}.channels"
        raise refusal(_WHERE, key, beyond[0], limit, code="no-such-channel", **values)
    channel = min(light.channels, key=lambda c: limits.longest_us[c])
    bounds = {limits.longest_us[channel]: f"the longest pulse of channel {channel} in its firmware"}
    if period_s is not None:
        bounds[_us(_ticks(period_s) // limits.share)] = f"1/{limits.share} of the period of {period_s} s"
    longest_us = min(bounds)
    return limits.shortest_us, longest_us, bounds[longest_us]


def light_step(
    name: str,
    config: ControllerConfig,
    limits: FirmwareLimits,
    period_s: float | None = None,
    on_us: float | None = None,
) -> Step:
    """Translate a light into a step of the firmware.

    The limit of the duty cycle is checked only if `period_s` is given. `on_us` replaces the on-time of station.toml.
    """
    if name not in config.lights:
        limit = f"one of {list(config.lights)}, the lights of station.toml"
        raise refusal(_PLAN, "lights", name, limit, code="unknown-light", light=name, known=", ".join(config.lights))
    light = config.lights[name]
    least_us, most_us, most = on_limits_us(name, config, limits, period_s)
    # The firmware checks this too, but its refusal names only a limit in ticks, not the channel or the period.
    asked_us = light.on_us if on_us is None else on_us
    width = _ticks(asked_us * 1e-6)
    if not _ticks(least_us * 1e-6) <= width <= _ticks(most_us * 1e-6):
        why = most if width > _ticks(most_us * 1e-6) else "the shortest pulse of its firmware"
        # A step that does not state an on-time has that of its light, so a different one is the step's own.
        key = f"controller.lights.{name}.on_us"
        where, wrong = (_WHERE, key) if asked_us == light.on_us else (_PLAN, f"on_us of light {name!r}")
        low, high = f"{least_us:g}", f"{most_us:g}"
        values = {"light": name, "value": f"{asked_us:g}", "low": low, "high": high}
        raise refusal(where, wrong, asked_us, f"{low} … {high} ({why})", code="on-time-beyond", **values)
    return Step(_mask(light), width)


def explain_refusal(nak: Nak, program: DeviceProgram) -> InputError | None:
    """Translate a refused COMMIT into the terms of `station.toml`. Return None if no value of that file caused it."""
    if nak.request != Type.COMMIT:
        return None
    if nak.reason == Reason.RANGE and nak.field in _FIELDS:
        where, key, unit = _FIELDS[nak.field]
        if program.timing.pacing == Pacing.DISTANCE and nak.field in _DISTANCES:
            key, unit = f"{key} in counts of the encoder", 1
        sent = astuple(program.timing)[nak.field]
        bound = "at least" if sent < nak.limit else "at most"
        limit = f"{bound} {nak.limit * unit:g}, a limit of the controller's firmware"
        return InputError.field(where, key, round(sent * unit, 7), limit)
    if nak.reason == Reason.LED_LIMIT and nak.field >= FIRST_STEP and program.lights:
        name = program.light(nak.field - FIRST_STEP)
        limit = f"{_us(nak.limit):g} µs at most, a limit of the controller's firmware"
        return InputError.field(_WHERE, f"controller.lights.{name}", "too much for its LEDs", limit)
    return None


def _mask(light: LightConfig) -> int:
    return sum({1 << channel for channel in light.channels})


def _ticks(time_s: float) -> int:
    return min(round(time_s / TICK_S), 0xFFFFFFFF)


def _us(ticks: int) -> float:
    return ticks * TICK_S * 1e6
