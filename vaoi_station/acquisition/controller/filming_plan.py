"""Make the trigger plan of a board type, and name every fault of its light program."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from vaoi_station.acquisition.cameras.interface import (
    EXPOSURE_TOLERANCE,
    EXPOSURE_TOLERANCE_US,
    GAIN_TOLERANCE_DB,
    STATED_TOLERANCE_DB,
    CameraExposure,
    CameraLimits,
    stated_tolerance_us,
)
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.errors import InputError
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, ProgramRow, ProgramStep
from vaoi_station.model.reason import Note
from vaoi_station.optics import longest_exposure_us, spare_time_us

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
    """Yield what a camera refuses of its exposures and gains when the line is armed, with the limits it has stated."""
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


def filming_plan(
    config: StationConfig, board_type: BoardType | None = None, px_per_mm: Sequence[float] = ()
) -> TriggerPlan:
    """Return the plan by which boards of a type are filmed. Without a board type, that of the station."""
    line = config.line if board_type is None else line_of_board(config, board_type)
    plan, faults = checked_plan(config, line, board_type, px_per_mm)
    require_none(faults)
    return plan


def checked_plan(
    config: StationConfig, line: Line, board_type: BoardType | None = None, px_per_mm: Sequence[float] = ()
) -> tuple[TriggerPlan, list[ProgramFault]]:
    """Return the plan of `filming_plan` on a line, and every fault that its light program has.

    A plan with faults must not be armed; the lists of values that do not fit the cameras are those of station.toml in
    it.
    """
    where, steps = "station.toml", config.program
    if board_type is not None and board_type.program:
        where, steps = _named(board_type), board_type.program
    faults: list[ProgramFault] = []
    rows = tuple(_row(where, n, step, config, faults) for n, step in enumerate(steps))
    for camera in range(len(config.cameras)):
        faults += _camera_faults(where, rows, config, line, camera, px_per_mm)
    by_trigger = _cameras_by_trigger(where, rows, config, faults)
    if by_trigger:
        rows = tuple(replace(row, trigger_us=row.exposures_us[by_trigger[0]]) for row in rows)
    plan = replace(TriggerPlan.of(line, program=rows), by_trigger=by_trigger)
    # Exposures of steps that are too long are named with their steps already.
    named = {fault.camera for fault in faults if fault.key == "exposure_us"}
    faults += [fault for fault in _time_faults(plan, config) if fault.camera not in named]
    return plan, faults


def line_of_board(config: StationConfig, board_type: BoardType) -> Line:
    """Return the line as it is for a board type: with the speed, rail, tail and longest board that the type states.

    Rows are filmed at the same places at any speed: delay, period and tail change with it.
    """
    line, asked, where = config.line, board_type.line, _named(board_type)
    if asked is None:
        return line
    speed_mm_s = line.speed_mm_s if asked.speed_mm_s is None else asked.speed_mm_s
    _check_range(where, "line.speed_mm_s", speed_mm_s, line.speed_limits_mm_s, line.speed_mm_s)
    expected = line.expected_board
    if asked.rail_mm is not None:
        if expected.rail_mm is None:
            limit = "absent: in station.toml no rail guides the boards (line.expected_board.rail_mm)"
            raise coded(InputError.field(where, "line.rail_mm", asked.rail_mm, limit), code="line-without-rail")
        _check_range(where, "line.rail_mm", asked.rail_mm, line.rail_limits_mm, expected.rail_mm)
        expected = expected.model_copy(update={"rail_mm": asked.rail_mm})
    longest_mm = line.longest_board_mm if asked.longest_board_mm is None else asked.longest_board_mm
    if longest_mm > line.longest_board_mm:
        limit = f"at most {line.longest_board_mm:g}, line.longest_board_mm in station.toml"
        error = InputError.field(where, "line.longest_board_mm", longest_mm, limit)
        raise coded(error, code="board-too-long", value=f"{longest_mm:g}", most=f"{line.longest_board_mm:g}")
    slower = line.speed_mm_s / speed_mm_s
    period_s = line.trigger_period_s * slower if asked.row_mm is None else asked.row_mm / speed_mm_s
    changed = {
        "conveyor_mm_s": tuple(v / slower for v in line.conveyor_mm_s),
        "start_delay_s": line.start_delay_s * slower,
        "trigger_period_s": period_s,
        "tail_s": line.tail_s * slower if asked.tail_s is None else asked.tail_s,
        "longest_board_mm": longest_mm,
        "expected_board": expected,
        "pacing": asked.pacing or line.pacing,
    }
    changed_line = line.model_copy(update=changed)
    if fault := changed_line.encoder_fault():
        error = InputError(f"{where}: line: {fault}.", action="Correct `line` of the board type, or [line.encoder].")
        raise coded(error, code="line-against-encoder")
    _check_rows(where, changed_line, config)
    return changed_line


def _check_range(where: str, key: str, value: float, limits: tuple[float, float] | None, only: float) -> None:
    name = {"line.speed_mm_s": "line.speed_limits_mm_s", "line.rail_mm": "line.rail_limits_mm"}[key]
    if limits is None and value != only:
        limit = f"{only:g} as in station.toml, which states no {name}"
        error = InputError.field(where, key, value, limit)
        raise coded(error, code="line-value-fixed", field=key, value=f"{value:g}", only=f"{only:g}", limits=name)
    if limits is not None and not limits[0] <= value <= limits[1]:
        low, high = (f"{limit:g}" for limit in limits)
        error = InputError.field(where, key, value, f"{low} … {high}, {name} in station.toml")
        raise coded(error, code="line-value-beyond", field=key, value=f"{value:g}", low=low, high=high)


def _check_rows(where: str, line: Line, config: StationConfig) -> None:
    """Raise InputError for a tail that leaves no pulse, or needs more rows than the ring has slots."""
    if line.passing_s < line.start_delay_s:
        least = f"{line.start_delay_s - line.longest_board_mm / line.speed_mm_s:.3f}"
        error = InputError.field(where, "line.tail_s", line.tail_s, f"at least {least}, else no pulse is fired")
        raise coded(error, code="tail-too-short", value=f"{line.tail_s:g}", least=least)
    if line.rows_of_longest_board > config.rows_per_run:
        slots = f"the ring has {config.rows_per_run} slots per camera"
        limit = f"shorter: it gives {line.rows_of_longest_board} rows, but {slots}"
        action = "Or raise ring.spare_rows in station.toml."
        error = InputError.field(where, "line.tail_s", line.tail_s, limit, action)
        numbers = {"rows": line.rows_of_longest_board, "slots": config.rows_per_run}
        raise coded(error, code="tail-too-long", value=f"{line.tail_s:g}", **numbers)


def _named(board_type: BoardType) -> str:
    return f"board type {board_type.name!r}"


def exposures_of(plan: TriggerPlan, config: StationConfig) -> list[CameraExposure]:
    """Return exposures and gain of every camera: of the rows of the program, else of station.toml."""
    if not plan.program:
        return [CameraExposure((camera.exposure_us,), camera.gain_db) for camera in config.cameras]
    return [
        CameraExposure(
            tuple(r.exposures_us[n] for r in plan.program),
            plan.program[0].gains_db[n],
            n in plan.by_trigger,
            _sequence(plan, n) if camera.exposure_by == "sequencer" else (),
        )
        for n, camera in enumerate(config.cameras)
    ]


def _sequence(plan: TriggerPlan, camera: int) -> tuple[tuple[float, float], ...]:
    """Return exposure and gain of the sets that a camera's sequencer needs; none if all rows have the same.

    A program that repeats itself for this camera, as one with lights in turn does, needs only the sets of one turn.
    """
    steps = tuple((row.exposures_us[camera], row.gains_db[camera]) for row in plan.program)
    turn = next(n for n in range(1, len(steps) + 1) if len(steps) % n == 0 and steps[:n] * (len(steps) // n) == steps)
    return steps[:turn] if turn > 1 else ()


def require_time(plan: TriggerPlan, config: StationConfig) -> None:
    """Raise InputError if the period of a plan is too short for a camera's longest exposure and read-out."""
    require_none(list(_time_faults(plan, config)))


def _time_faults(plan: TriggerPlan, config: StationConfig) -> Iterator[ProgramFault]:
    """Yield a fault for each camera whose longest exposure and read-out do not fit into the period of a plan."""
    for n, camera in enumerate(config.cameras):
        exposure_us = max((row.exposures_us[n] for row in plan.program), default=camera.exposure_us)
        if spare_time_us(plan.shortest_period_s * 1e6, exposure_us, camera.readout_us) < 0:
            needed_s = (exposure_us + camera.readout_us) * 1e-6
            limit = (
                f"at least {needed_s:g}: camera {camera.name!r} exposes for {exposure_us:g} µs "
                f"and is read out in {camera.readout_us:g} µs"
            )
            if plan.belt is not None:
                limit += f", and at its fastest the belt brings a row every {plan.shortest_period_s:g} s"
            error = InputError.field("trigger plan", "period_s", plan.shortest_period_s, limit)
            times = {"value": f"{plan.shortest_period_s:g}", "least": f"{needed_s:g}", "exposure": f"{exposure_us:g}"}
            coded(error, code="period-too-short", camera=camera.label, **times)
            yield ProgramFault(error, camera=n)


def longest_lit_us(config: StationConfig, line: Line, camera: int, px_per_mm: Sequence[float]) -> float | None:
    """Return the longest time for which light may fall on a camera's sensor; None if its resolution is not known."""
    resolution = _resolution(config, camera, px_per_mm)
    return None if resolution is None else longest_exposure_us(line.max_blur_px, line.fastest_mm_s, resolution)


def _resolution(config: StationConfig, camera: int, px_per_mm: Sequence[float]) -> float | None:
    return px_per_mm[camera] if px_per_mm else config.cameras[camera].nominal_px_per_mm


def _row(where: str, number: int, step: ProgramStep, config: StationConfig, faults: list[ProgramFault]) -> ProgramRow:
    """Return a step with all its values; what it does not state is taken from station.toml. Faults are added."""
    light = config.controller.lights.get(step.light)
    if config.controller.backend == "serial" and light is None:
        known = ", ".join(map(repr, config.controller.lights)) or "none"
        limit = f"a light of [controller.lights] in station.toml, which has {known}"
        error = InputError.field(where, f"program.{number}.light", step.light, limit)
        coded(error, code="unknown-light", light=step.light, known=", ".join(config.controller.lights))
        faults.append(ProgramFault(error, number, "light"))
    cameras = config.cameras
    values = {"exposure_us": [c.exposure_us for c in cameras], "gain_db": [c.gain_db for c in cameras]}
    for key, default in values.items():
        given = getattr(step, key)
        if given is not None and len(given) not in (1, len(default)):
            limit = f"one for all cameras, or {len(default)}, one per camera"
            error = InputError.field(where, f"number of entries of program.{number}.{key}", len(given), limit)
            coded(error, code="values-per-camera", field=key, count=len(given), cameras=len(default))
            faults.append(ProgramFault(error, number, key))
        elif given is not None:
            values[key] = [*given] * len(default) if len(given) == 1 else [*given]
    on_us = step.on_us if step.on_us is not None else light.on_us if light is not None else None
    return ProgramRow(
        light=step.light, exposures_us=tuple(values["exposure_us"]), gains_db=tuple(values["gain_db"]), on_us=on_us
    )


def _camera_faults(
    where: str, rows: Sequence[ProgramRow], config: StationConfig, line: Line, number: int, px_per_mm: Sequence[float]
) -> Iterator[ProgramFault]:
    """Yield why a camera cannot follow the program, and where its pictures would be blurred by the motion."""
    camera = config.cameras[number]
    resolution = _resolution(config, number, px_per_mm)
    longest_us = longest_lit_us(config, line, number, px_per_mm)
    for n, row in enumerate(rows):
        exposure_us, lit_us = row.exposures_us[number], row.lit_us[number]
        if spare_time_us(line.shortest_period_s * 1e6, exposure_us, camera.readout_us) < 0:
            readout = f" minus {camera.readout_us:g} µs of read-out" if camera.readout_us else ""
            most_us = line.shortest_period_s * 1e6 - camera.readout_us
            limit = f"at most {most_us:g} for {camera.label}: pulses follow every {line.shortest_period_s:g} s{readout}"
            limit += f" at {line.fastest_mm_s:g} mm/s, the fastest of the encoder" if line.by_encoder else ""
            error = InputError.field(where, f"program.{n}.exposure_us", exposure_us, limit)
            times = {"value": f"{exposure_us:g}", "most": f"{most_us:g}"}
            coded(error, code="exposure-beyond-period", camera=camera.label, **times)
            yield ProgramFault(error, n, "exposure_us", number)
        if longest_us is not None and lit_us > longest_us * (1 + 1e-9):
            key = "exposure_us" if lit_us == exposure_us else "on_us"
            limit = (
                f"at most {longest_us:.1f} for {camera.label}: at {line.fastest_mm_s:g} mm/s and {resolution:.4g} px/mm"
                f" the picture moves {line.max_blur_px:g} px in that time (line.max_blur_px)"
            )
            error = InputError.field(where, f"program.{n}.{key}", lit_us, limit, "Shorten it, or raise the gain.")
            times = {"value": f"{lit_us:g}", "most": f"{longest_us:.1f}", "blur": f"{line.max_blur_px:g}"}
            coded(error, code="motion-blur", camera=camera.label, field=key, **times)
            yield ProgramFault(error, n, key, number)
    yield from _register_faults(where, rows, camera, number)
    yield from _sequence_faults(where, rows, camera, number)


def _cameras_by_trigger(
    where: str, rows: Sequence[ProgramRow], config: StationConfig, faults: list[ProgramFault]
) -> tuple[int, ...]:
    """Return the cameras whose exposure the width of the trigger sets.

    A fault is added for different exposures of theirs in one row, because one trigger line fires all of them.
    """
    cameras = tuple(
        n
        for n, camera in enumerate(config.cameras)
        if camera.backend == "aravis" and rows and _is_by_trigger(camera, [row.exposures_us[n] for row in rows])
    )
    for n, row in enumerate(rows):
        for other in cameras[1:]:
            first, exposure_us = row.exposures_us[cameras[0]], row.exposures_us[other]
            if exposure_us != first:
                label, limit = config.cameras[other].label, f"{first:g} µs as for {config.cameras[cameras[0]].label}"
                error = InputError.field(
                    where,
                    f"program.{n}.exposure_us",
                    exposure_us,
                    f"{limit}: the width of one trigger is the exposure of both",
                    f'Or give {label} one exposure for all rows, with exposure_by = "register".',
                )
                values = {"value": f"{exposure_us:g}", "only": f"{first:g}"}
                coded(error, code="one-trigger-width", camera=label, other=config.cameras[cameras[0]].label, **values)
                faults.append(ProgramFault(error, n, "exposure_us", other))
    return cameras


def _is_by_trigger(camera: CameraConfig, exposures_us: Sequence[float]) -> bool:
    if camera.exposure_by == "auto":
        return len(set(exposures_us)) > 1
    return camera.exposure_by == "trigger-width"


def _register_faults(
    where: str, rows: Sequence[ProgramRow], camera: CameraConfig, number: int
) -> Iterator[ProgramFault]:
    """Yield a fault if a real camera would have to change a register from row to row."""
    if camera.backend != "aravis" or camera.exposure_by == "sequencer":
        return
    # A value that is written to the camera between two rows may take effect before or after the next pulse.
    registers = [("gain_db", "dB", [row.gains_db[number] for row in rows])]
    if camera.exposure_by == "register":
        registers.append(("exposure_us", "µs", [row.exposures_us[number] for row in rows]))
    for key, unit, values in registers:
        other = next((n for n, value in enumerate(values) if value != values[0]), None)
        if other is not None:
            error = InputError.field(
                where,
                f"program.{other}.{key}",
                values[other],
                f"{values[0]:g} {unit} as in program.0: {camera.label} has one {key} for all rows of a program",
                "Let the on-time of the LEDs (on_us) make the difference between rows, or, with a camera that has one, "
                'the sequencer (exposure_by = "sequencer").',
            )
            given = {"value": f"{values[other]:g} {unit}", "only": f"{values[0]:g} {unit}"}
            coded(error, code="one-value-for-all-rows", camera=camera.label, field=key, **given)
            yield ProgramFault(error, other, key, number)


def _sequence_faults(
    where: str, rows: Sequence[ProgramRow], camera: CameraConfig, number: int
) -> Iterator[ProgramFault]:
    """Yield the steps of a sequencer if frames of two of them might state the same exposure and gain."""
    if camera.backend != "aravis" or camera.exposure_by != "sequencer":
        return
    steps = [(row.exposures_us[number], row.gains_db[number]) for row in rows]
    for n, (exposure_us, gain_db) in enumerate(steps):
        for before, (other_us, other_db) in enumerate(steps[:n]):
            apart_us = stated_tolerance_us(exposure_us) + stated_tolerance_us(other_us)
            near = abs(exposure_us - other_us) < apart_us and abs(gain_db - other_db) < 2 * STATED_TOLERANCE_DB
            if near and (exposure_us, gain_db) != (other_us, other_db):
                key, value = "exposure_us", exposure_us
                limit = f"{other_us:g} as in program.{before}, or at least {apart_us:g} µs from it"
                if exposure_us == other_us:
                    key, value = "gain_db", gain_db
                    limit = f"{other_db:g} as in program.{before}, or at least {2 * STATED_TOLERANCE_DB:g} dB from it"
                error = InputError.field(
                    where,
                    f"program.{n}.{key}",
                    value,
                    f"{limit}: by what the frames of {camera.label} state, the two steps could not be distinguished",
                    "Or let the on-time of the LEDs (on_us) make the difference between these rows.",
                )
                coded(error, code="steps-too-alike", camera=camera.label, field=key, value=f"{value:g}", other=before)
                yield ProgramFault(error, n, key, number)
