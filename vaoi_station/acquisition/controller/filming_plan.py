"""Make the trigger plan of a board type, and name every fault of its light program."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from vaoi_station.acquisition.cameras.interface import (
    GAIN_TOLERANCE_DB,
    CameraExposure,
    CameraLimits,
    exposure_tolerance_us,
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
    """None if the fault concerns the whole program or the line."""
    key: str = ""
    """The key of the step that is wrong; empty if it is none of them."""
    camera: int | None = None


def refusal(
    where: str, key: str, value: object, limit: str, action: str = "", /, *, code: str, **values: object
) -> InputError:
    """Return `InputError.field` with a code and the values that it states, for texts in other languages."""
    error = InputError.field(where, key, value, limit, action)
    error.message = Note(code, error.message, **values)
    return error


def require_none(faults: Iterable[ProgramFault]) -> None:
    """Raise one InputError that names all faults, at most `MOST_SHOWN` of them; return if there are none."""
    errors = [fault.error for fault in faults]
    if len(errors) == 1:
        raise errors[0]
    if errors:
        # Several cameras often have the same fault with different numbers; a person corrects the first ones first.
        messages = list(dict.fromkeys(error.message for error in errors))
        more = len(messages) - MOST_SHOWN
        shown = " ".join(messages[:MOST_SHOWN]) + (f" And {more} more." if more > 0 else "")
        raise InputError(shown, action=next((error.action for error in errors if error.action), ""))


def unknown_lights(program: Sequence[ProgramRow], lights: Collection[str]) -> list[ProgramFault]:
    """Return a fault for each step with a light that a simulated line does not have."""
    limit = f"a light of the scenario, which has {', '.join(map(repr, lights))}"
    return [
        ProgramFault(_unknown_light(OF_PROGRAM[0], n, row.light, limit, lights), n, "light")
        for n, row in enumerate(program)
        if row.light not in lights
    ]


def _unknown_light(where: str, step: int, light: str, limit: str, known: Iterable[str]) -> InputError:
    code = "unknown-light"
    return refusal(where, f"program.{step}.light", light, limit, code=code, light=light, known=", ".join(known))


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
        values = {"camera": label, "count": count, "most": limits.sets or 0}
        where, key = OF_PROGRAM[0], "number of different steps"
        yield ProgramFault(
            refusal(where, key, count, limit, action, code="sequencer-too-short", **values), camera=camera
        )
    checks = [("gain_db", "dB", tuple(gains_db), limits.gain_db)]
    if not wanted.by_trigger:
        checks.insert(0, ("exposure_us", "µs", wanted.exposures_us, limits.exposure_us))
    for key, unit, steps, bounds in checks:
        for n, value in enumerate(steps):
            near = exposure_tolerance_us(value) if unit == "µs" else GAIN_TOLERANCE_DB
            # The sets of a sequencer are compared exactly; a register is read back, and a camera may have rounded it.
            spare = 0.0 if wanted.sequence else near
            if bounds is None or bounds[0] - spare <= value <= bounds[1] + spare:
                continue
            limit = f"{bounds[0]:g} … {bounds[1]:g} {unit}, the limits that {label} states"
            given = {"value": f"{value:g} {unit}", "low": f"{bounds[0]:g}", "high": f"{bounds[1]:g} {unit}"}
            field = names[1].format(step=n) + key
            error = refusal(names[0], field, value, limit, code="beyond-camera", camera=label, field=key, **given)
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
    """Return the plan of `filming_plan` on a line, and every fault of its light program; with one it is not armed."""
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
    faults += [fault for fault in time_faults(plan, config) if fault.camera not in named]
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
            raise refusal(where, "line.rail_mm", asked.rail_mm, limit, code="line-without-rail")
        _check_range(where, "line.rail_mm", asked.rail_mm, line.rail_limits_mm, expected.rail_mm)
        expected = expected.model_copy(update={"rail_mm": asked.rail_mm})
    longest_mm = line.longest_board_mm if asked.longest_board_mm is None else asked.longest_board_mm
    if longest_mm > line.longest_board_mm:
        value, most = f"{longest_mm:g}", f"{line.longest_board_mm:g}"
        limit = f"at most {most}, line.longest_board_mm in station.toml"
        raise refusal(where, "line.longest_board_mm", longest_mm, limit, code="board-too-long", value=value, most=most)
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
        error.message = Note("line-against-encoder", error.message)
        raise error
    _check_rows(where, changed_line, config)
    return changed_line


def _check_range(where: str, key: str, value: float, limits: tuple[float, float] | None, only: float) -> None:
    name = {"line.speed_mm_s": "line.speed_limits_mm_s", "line.rail_mm": "line.rail_limits_mm"}[key]
    given = {"field": key, "value": f"{value:g}", "limits": name}
    if limits is None and value != only:
        limit = f"{only:g} as in station.toml, which states no {name}"
        raise refusal(where, key, value, limit, code="line-value-fixed", only=f"{only:g}", **given)
    if limits is not None and not limits[0] <= value <= limits[1]:
        low, high = (f"{limit:g}" for limit in limits)
        limit = f"{low} … {high}, {name} in station.toml"
        raise refusal(where, key, value, limit, code="line-value-beyond", low=low, high=high, **given)


def _check_rows(where: str, line: Line, config: StationConfig) -> None:
    """Raise InputError for a tail that leaves no pulse, or needs more rows than the ring has slots."""
    key, tail_s, shown = "line.tail_s", line.tail_s, f"{line.tail_s:g}"
    if line.passing_s < line.start_delay_s:
        least = f"{line.start_delay_s - line.longest_board_mm / line.speed_mm_s:.3f}"
        limit = f"at least {least}, else no pulse is fired"
        raise refusal(where, key, tail_s, limit, code="tail-too-short", value=shown, least=least)
    rows, slots = line.rows_of_longest_board, config.rows_per_run
    if rows > slots:
        limit = f"shorter: it gives {rows} rows, but the ring has {slots} slots per camera"
        action = "Or raise ring.spare_rows in station.toml."
        raise refusal(where, key, tail_s, limit, action, code="tail-too-long", value=shown, rows=rows, slots=slots)


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


def time_faults(plan: TriggerPlan, config: StationConfig) -> Iterator[ProgramFault]:
    """Yield a fault for each camera whose longest exposure and read-out do not fit into the period of a plan."""
    period_s = plan.shortest_period_s
    for n, camera in enumerate(config.cameras):
        exposure_us = max((row.exposures_us[n] for row in plan.program), default=camera.exposure_us)
        if spare_time_us(period_s * 1e6, exposure_us, camera.readout_us) < 0:
            least = f"{(exposure_us + camera.readout_us) * 1e-6:g}"
            limit = (
                f"at least {least}: camera {camera.name!r} exposes for {exposure_us:g} µs "
                f"and is read out in {camera.readout_us:g} µs"
            )
            if plan.belt is not None:
                limit += f", and at its fastest the belt brings a row every {period_s:g} s"
            values = {"camera": camera.label, "value": f"{period_s:g}", "least": least, "exposure": f"{exposure_us:g}"}
            error = refusal(OF_PROGRAM[0], "period_s", period_s, limit, code="period-too-short", **values)
            yield ProgramFault(error, camera=n)


def link_faults(plan: TriggerPlan, row_s: float | None) -> Iterator[ProgramFault]:
    """Yield a fault if rows of a plan come faster than the links carry them. `row_s` is None if that is not known."""
    period_s = plan.shortest_period_s
    if row_s is not None and row_s > period_s:
        value, least = f"{period_s:g}", f"{row_s:.4g}"
        limit = f"at least {least}: the links of the cameras carry a row in that time"
        action = "Film rows farther apart, or give the cameras faster links."
        values = {"value": value, "least": least}
        error = refusal(OF_PROGRAM[0], "period_s", period_s, limit, action, code="rows-beyond-links", **values)
        yield ProgramFault(error)


def longest_lit_us(config: StationConfig, line: Line, camera: int, px_per_mm: Sequence[float]) -> float | None:
    """Return the longest time for which light may fall on a camera's sensor; None if its resolution is not known."""
    resolution = _resolution(config, camera, px_per_mm)
    return None if resolution is None else longest_exposure_us(line.max_blur_px, line.fastest_mm_s, resolution)


def _resolution(config: StationConfig, camera: int, px_per_mm: Sequence[float]) -> float | None:
    return px_per_mm[camera] if px_per_mm else config.cameras[camera].nominal_px_per_mm


def _row(where: str, number: int, step: ProgramStep, config: StationConfig, faults: list[ProgramFault]) -> ProgramRow:
    """Return a step with all its values; what it does not state is taken from station.toml. Faults are added."""
    lights, cameras = config.controller.lights, config.cameras
    if config.controller.backend == "serial" and step.light not in lights:
        known = ", ".join(map(repr, lights)) or "none"
        limit = f"a light of [controller.lights] in station.toml, which has {known}"
        faults.append(ProgramFault(_unknown_light(where, number, step.light, limit, lights), number, "light"))
    values = {"exposure_us": [c.exposure_us for c in cameras], "gain_db": [c.gain_db for c in cameras]}
    for key in values:
        given = getattr(step, key)
        if given is None:
            continue
        if len(given) in (1, len(cameras)):
            values[key] = [*given] * (len(cameras) // len(given))
            continue
        limit, field = f"one for all cameras, or {len(cameras)}, one per camera", f"program.{number}.{key}"
        counts = {"field": key, "count": len(given), "cameras": len(cameras)}
        error = refusal(where, f"number of entries of {field}", len(given), limit, code="values-per-camera", **counts)
        faults.append(ProgramFault(error, number, key))
    on_us = step.on_us if step.on_us is not None or step.light not in lights else lights[step.light].on_us
    return ProgramRow(step.light, tuple(values["exposure_us"]), tuple(values["gain_db"]), on_us)


def _camera_faults(
    where: str, rows: Sequence[ProgramRow], config: StationConfig, line: Line, number: int, px_per_mm: Sequence[float]
) -> Iterator[ProgramFault]:
    camera = config.cameras[number]
    resolution = _resolution(config, number, px_per_mm)
    longest_us = longest_lit_us(config, line, number, px_per_mm)
    for n, row in enumerate(rows):
        exposure_us, lit_us = row.exposures_us[number], row.lit_us[number]
        if spare_time_us(line.shortest_period_s * 1e6, exposure_us, camera.readout_us) < 0:
            readout = f" minus {camera.readout_us:g} µs of read-out" if camera.readout_us else ""
            most = f"{line.shortest_period_s * 1e6 - camera.readout_us:g}"
            limit = f"at most {most} for {camera.label}: pulses follow every {line.shortest_period_s:g} s{readout}"
            limit += f" at {line.fastest_mm_s:g} mm/s, the fastest of the encoder" if line.by_encoder else ""
            key, values = "exposure_us", {"camera": camera.label, "value": f"{exposure_us:g}", "most": most}
            error = refusal(where, f"program.{n}.{key}", exposure_us, limit, code="exposure-beyond-period", **values)
            yield ProgramFault(error, n, key, number)
        if longest_us is not None and lit_us > longest_us * (1 + 1e-9):
            key, most = "exposure_us" if lit_us == exposure_us else "on_us", f"{longest_us:.1f}"
            limit = (
                f"at most {most} for {camera.label}: at {line.fastest_mm_s:g} mm/s and {resolution:.4g} px/mm"
                f" the picture moves {line.max_blur_px:g} px in that time (line.max_blur_px)"
            )
            action, blur = "Shorten it, or raise the gain.", f"{line.max_blur_px:g}"
            values = {"camera": camera.label, "field": key, "value": f"{lit_us:g}", "most": most, "blur": blur}
            error = refusal(where, f"program.{n}.{key}", lit_us, limit, action, code="motion-blur", **values)
            yield ProgramFault(error, n, key, number)
    if camera.backend == "aravis" and camera.exposure_by == "sequencer":
        yield from _sequence_faults(where, rows, camera, number)
    elif camera.backend == "aravis":
        yield from _register_faults(where, rows, camera, number)


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
            first_us, exposure_us = row.exposures_us[cameras[0]], row.exposures_us[other]
            if exposure_us != first_us:
                label, first = config.cameras[other].label, config.cameras[cameras[0]].label
                limit = f"{first_us:g} µs as for {first}: the width of one trigger is the exposure of both"
                action = f'Or give {label} one exposure for all rows, with exposure_by = "register".'
                values = {"camera": label, "other": first, "value": f"{exposure_us:g}", "only": f"{first_us:g}"}
                key = f"program.{n}.exposure_us"
                error = refusal(where, key, exposure_us, limit, action, code="one-trigger-width", **values)
                faults.append(ProgramFault(error, n, "exposure_us", other))
    return cameras


def _is_by_trigger(camera: CameraConfig, exposures_us: Sequence[float]) -> bool:
    if camera.exposure_by == "auto":
        return len(set(exposures_us)) > 1
    return camera.exposure_by == "trigger-width"


def _register_faults(
    where: str, rows: Sequence[ProgramRow], camera: CameraConfig, number: int
) -> Iterator[ProgramFault]:
    # A value that is written to the camera between two rows may take effect before or after the next pulse.
    registers = [("gain_db", "dB", [row.gains_db[number] for row in rows])]
    if camera.exposure_by == "register":
        registers.append(("exposure_us", "µs", [row.exposures_us[number] for row in rows]))
    for key, unit, values in registers:
        other = next((n for n, value in enumerate(values) if value != values[0]), None)
        if other is not None:
            limit = f"{values[0]:g} {unit} as in program.0: {camera.label} has one {key} for all rows of a program"
            action = (
                "Let the on-time of the LEDs (on_us) make the difference between rows, or, with a camera that has one, "
                'the sequencer (exposure_by = "sequencer").'
            )
            given = {"field": key, "value": f"{values[other]:g} {unit}", "only": f"{values[0]:g} {unit}"}
            name = f"program.{other}.{key}"
            code = "one-value-for-all-rows"
            error = refusal(where, name, values[other], limit, action, code=code, camera=camera.label, **given)
            yield ProgramFault(error, other, key, number)


def _sequence_faults(
    where: str, rows: Sequence[ProgramRow], camera: CameraConfig, number: int
) -> Iterator[ProgramFault]:
    """Yield the steps of a sequencer if frames of two of them might state the same exposure and gain."""
    steps = [(row.exposures_us[number], row.gains_db[number]) for row in rows]
    for n, (exposure_us, gain_db) in enumerate(steps):
        for before, (other_us, other_db) in enumerate(steps[:n]):
            apart_us = exposure_tolerance_us(exposure_us) + exposure_tolerance_us(other_us)
            near = abs(exposure_us - other_us) < apart_us and abs(gain_db - other_db) < 2 * GAIN_TOLERANCE_DB
            if not near or (exposure_us, gain_db) == (other_us, other_db):
                continue
            key, value, other, apart = "exposure_us", exposure_us, other_us, f"{apart_us:g} µs"
            if exposure_us == other_us:
                key, value, other, apart = "gain_db", gain_db, other_db, f"{2 * GAIN_TOLERANCE_DB:g} dB"
            limit = (
                f"{other:g} as in program.{before}, or at least {apart} from it: by what the frames of {camera.label} "
                "state, the two steps could not be distinguished"
            )
            action = "Or let the on-time of the LEDs (on_us) make the difference between these rows."
            given = {"camera": camera.label, "field": key, "value": f"{value:g}", "other": before}
            error = refusal(where, f"program.{n}.{key}", value, limit, action, code="steps-too-alike", **given)
            yield ProgramFault(error, n, key, number)
