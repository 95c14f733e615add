"""Checks of a light program without arming the line: every fault that arming would refuse, at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple

from pydantic import Field

from vaoi_station.acquisition.cameras.interface import CameraLimits
from vaoi_station.acquisition.controller.filming_plan import (
    OF_PROGRAM,
    ProgramFault,
    beyond_camera,
    checked_plan,
    exposures_of,
    line_of_board,
    link_faults,
    longest_lit_us,
    unknown_lights,
)
from vaoi_station.acquisition.controller.interface import FirmwareLimits, TriggerPlan
from vaoi_station.acquisition.controller.serial.device_program import on_limits_us, program_faults
from vaoi_station.acquisition.process.messages import Health
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, ProgramRow, Strict
from vaoi_station.model.reason import Note
from vaoi_station.model.recording import MOST_STEPS, Program

Limits = tuple[float, float]
Origin = Literal["request", "board-type", "station", "cameras"]
Way = Literal["rows", "trigger-width", "register", "sequencer"]


class ProgramFaultEntry(Strict):
    """One fault of a light program."""

    step: int | None = Field(default=None, description="Index of the step; absent: the whole program or the line.")
    field: str | None = Field(default=None, description="The key of the step that is wrong.")
    camera: int | None = Field(default=None, description="The camera that cannot follow.")
    message: str
    action: str | None = None
    code: str = Field(description="What it is, for programs.")
    values: dict[str, str] = Field(description="What the message states, as it is written there.")


class ProgramNote(Strict):
    """What could not be checked."""

    code: str
    message: str
    values: dict[str, str] = Field(description="What the message states: names of cameras and settings.")


class ProgramStepValues(Strict):
    """One step with all its values, as rows are filmed with it."""

    light: str
    on_us: float | None = Field(default=None, description="Absent: the light shines for the whole exposure.")
    exposures_us: tuple[float, ...] = Field(description="Exposure of every camera.")
    gains_db: tuple[float, ...] = Field(description="Gain of every camera.")
    lit_us: tuple[float, ...] = Field(description="How long light falls on the sensor of every camera.")
    trigger_us: float | None = Field(default=None, description="Width of the trigger where it sets exposures.")


class ProgramCamera(Strict):
    """What bounds the exposures of one camera."""

    camera: int
    name: str
    exposure_us: float = Field(description="Exposure of station.toml.")
    gain_db: float = Field(description="Gain of station.toml.")
    readout_us: float = Field(description="Read-out that must end before the next row.")
    px_per_mm: float | None = Field(default=None, description="Resolution; absent: not known.")
    longest_lit_us: float | None = Field(default=None, description="Longest light with which motion blurs no more.")
    way: Way = Field(
        description="How its exposure changes: from row to row, by the width of the trigger, by its register (one for "
        "all rows), by its sequencer."
    )
    exposure_limits_us: Limits | None = Field(default=None, description="Limits that the camera states.")
    gain_limits_db: Limits | None = Field(default=None, description="Limits that the camera states.")


class ProgramLight(Strict):
    """A light that steps may name."""

    name: str
    channels: tuple[int, ...] = ()
    on_us: float | None = Field(default=None, description="On-time of station.toml; absent: the whole exposure.")
    on_limits_us: Limits | None = Field(default=None, description="Limits of the controller's firmware at this period.")


class ProgramCheck(Strict):
    """A light program with all its values, its limits, and all its faults."""

    board_type: str
    origin: Origin = Field(
        description="Whose program it is: of the request, the board type, or station.toml; `cameras`: there is none, "
        "and lights and exposures are those of station.toml."
    )
    usable: bool = Field(description="No fault was found; what `unchecked` lists shows when it is armed.")
    faults: tuple[ProgramFaultEntry, ...]
    unchecked: tuple[ProgramNote, ...] = Field(description="What was not checked: no device has stated its limits.")
    steps: tuple[ProgramStepValues, ...]
    most_steps: int = Field(description="Largest number of steps.")
    period_s: float = Field(description="Shortest time between two rows.")
    speed_mm_s: float = Field(description="Fastest speed of the belt.")
    max_blur_px: float
    cameras: tuple[ProgramCamera, ...]
    lights: tuple[ProgramLight, ...]


class LightPrograms:
    """Checks light programs against a station: its line, its cameras, and what its devices have stated of themselves.

    Methods may be called from any thread.
    """

    def __init__(self, config: StationConfig, px_per_mm: Sequence[float], health: Callable[[], Health | None]) -> None:
        """Prepare checks.

        Args:
            config: the station.
            px_per_mm: resolution of every camera by its calibration; empty: nominal ones count.
            health: returns the latest report of the devices; None while there is none.
        """
        self._config, self._px_per_mm, self._health = config, px_per_mm, health

    def check(self, board_type: BoardType, program: Program | None = None) -> ProgramCheck:
        """Check a program as if the line were armed with it; without one, the program that is in force.

        Args:
            board_type: gives speed and lengths of the line, and its program if no other one is given.
            program: the steps; empty: those of the station.
        """
        config, stated = self._config, _Stated.of(self._health(), len(self._config.cameras))
        origin: Origin = "station" if config.program else "cameras"
        if program is not None:
            board_type = board_type.model_copy(update={"program": program or None})
        if board_type.program:
            origin = "request" if program else "board-type"
        faults: list[ProgramFault] = []
        try:
            line = line_of_board(config, board_type)
        except InputError as error:
            faults.append(ProgramFault(error))
            line = config.line
        plan, found = checked_plan(config, line, board_type, self._px_per_mm)
        faults += found
        faults += self._device_faults(plan, stated, faults)
        # Controller and computer may name the same.
        unlike = {(fault.step, fault.key, fault.camera, fault.error.message): fault for fault in faults}
        return ProgramCheck(
            board_type=board_type.name,
            origin=origin,
            usable=not faults,
            faults=tuple(map(_entry, unlike.values())),
            unchecked=tuple(
                ProgramNote(code=note.code, message=note, values=dict(note.values))
                for note in self._unchecked(plan, stated)
            ),
            steps=tuple(
                ProgramStepValues(**{name: getattr(row, name) for name in ProgramStepValues.model_fields})
                for row in plan.program or self._without_program()
            ),
            most_steps=MOST_STEPS if stated.firmware is None else stated.firmware.steps,
            period_s=plan.shortest_period_s,
            speed_mm_s=line.fastest_mm_s,
            max_blur_px=line.max_blur_px,
            cameras=tuple(self._camera(n, line, limits) for n, limits in enumerate(stated.cameras)),
            lights=self._lights(plan, stated),
        )

    def _device_faults(
        self, plan: TriggerPlan, stated: _Stated, found: Sequence[ProgramFault]
    ) -> Iterator[ProgramFault]:
        """Yield what controller and cameras refuse. A light that is named as unknown already is not named again."""
        if stated.lights is not None:
            yield from unknown_lights(plan.program, stated.lights)
        if stated.firmware is not None:
            known = {fault.step for fault in found if fault.key == "light"}
            for fault in program_faults(plan, self._config.controller, stated.firmware):
                if fault.key != "light" or fault.step not in known:
                    yield fault
        rows_s = [limits.row_s for limits in stated.cameras if limits is not None and limits.row_s is not None]
        yield from link_faults(plan, max(rows_s, default=None))
        for n, (wanted, limits) in enumerate(zip(exposures_of(plan, self._config), stated.cameras, strict=True)):
            if limits is not None:
                gains_db, label = [row.gains_db[n] for row in plan.program], self._config.cameras[n].label
                names = OF_PROGRAM if plan.program else ("station.toml", f"cameras.{n}.")
                yield from beyond_camera(wanted, gains_db or [wanted.gain_db], limits, n, label, names)

    def _unchecked(self, plan: TriggerPlan, stated: _Stated) -> Iterator[Note]:
        """Yield in sentences what no device has stated. Simulated and replayed devices have no limits of their own."""
        if stated.firmware is None and (self._config.controller.backend == "serial" or not stated.reported):
            sentence = "The limits of the controller are not known: it has not reported yet."
            yield Note("controller-limits-unknown", sentence)
        for camera, limits in zip(self._config.cameras, stated.cameras, strict=True):
            if camera.backend != "aravis":
                continue
            if limits is None:
                sentence = f"The limits of {camera.label} are not known: it is not connected."
                yield Note("camera-limits-unknown", sentence, camera=camera.label)
                continue
            for name, known in (("exposure", limits.exposure_us), ("gain", limits.gain_db)):
                if not known:
                    sentence = f"{camera.label} states no limits of its {name}."
                    yield Note("camera-limits-not-stated", sentence, camera=camera.label, field=name)
        # No camera states these before the line is armed. That frames state their exposure is known: a camera with
        # exposure_by = "sequencer" is connected only if they can.
        wanted = list(zip(self._config.cameras, exposures_of(plan, self._config), strict=True))
        armed = "It shows when the line is armed whether"
        if who := ", ".join(camera.label for camera, own in wanted if own.by_trigger):
            sentence = f"{armed} {who} can expose for the width of the trigger."
            yield Note("trigger-width-unproven", sentence, cameras=who)
        if who := ", ".join(camera.label for camera, own in wanted if own.sequence):
            yield Note("sequencer-unproven", f"{armed} {who} can advance its sequencer per frame.", cameras=who)

    def _without_program(self) -> list[ProgramRow]:
        """Return what rows are filmed with if there is no program: the lights in turn, each with the same exposures."""
        config = self._config
        exposures_us = tuple(camera.exposure_us for camera in config.cameras)
        gains_db = tuple(camera.gain_db for camera in config.cameras)
        lights = config.controller.lights
        return [
            ProgramRow(light=name, exposures_us=exposures_us, gains_db=gains_db, on_us=lights[name].on_us)
            for name in config.controller.light_sequence
        ]

    def _camera(self, number: int, line: Line, limits: CameraLimits | None) -> ProgramCamera:
        camera = self._config.cameras[number]
        way: Way = "trigger-width" if camera.exposure_by == "auto" else camera.exposure_by
        return ProgramCamera(
            camera=number,
            name=camera.name,
            exposure_us=camera.exposure_us,
            gain_db=camera.gain_db,
            readout_us=camera.readout_us,
            px_per_mm=self._px_per_mm[number] if self._px_per_mm else camera.nominal_px_per_mm,
            longest_lit_us=longest_lit_us(self._config, line, number, self._px_per_mm),
            way=way if camera.backend == "aravis" else "rows",
            exposure_limits_us=limits.exposure_us if limits is not None else None,
            gain_limits_db=limits.gain_db if limits is not None else None,
        )

    def _lights(self, plan: TriggerPlan, stated: _Stated) -> tuple[ProgramLight, ...]:
        config, firmware = self._config.controller, stated.firmware
        if config.backend != "serial":
            # The lights of a simulation are those of its scenario; a replay has those that its recordings name.
            return tuple(ProgramLight(name=name) for name in stated.lights or ())
        found = []
        for name, light in config.lights.items():
            limits_us = None
            if firmware is not None:
                with suppress(InputError):  # a channel that does not exist: the faults name it
                    limits_us = on_limits_us(name, config, firmware, plan.shortest_period_s)[:2]
            found.append(
                ProgramLight(name=name, channels=light.channels, on_us=light.on_us, on_limits_us=limits_us)
            )  # fmt: skip
        return tuple(found)


class _Stated(NamedTuple):
    """What the devices have stated of themselves; None: nothing."""

    reported: bool
    firmware: FirmwareLimits | None
    lights: tuple[str, ...] | None
    cameras: tuple[CameraLimits | None, ...]

    @classmethod
    def of(cls, health: Health | None, cameras: int) -> _Stated:
        """Return what the latest report of the devices states."""
        if health is None:
            return cls(False, None, None, (None,) * cameras)
        known = [camera.limits for camera in health.cameras[:cameras]]
        limits, absent = health.limits, [None] * (cameras - len(known))
        firmware, lights = (None, None) if limits is None else (limits.firmware, limits.lights)
        return cls(True, firmware, lights, (*known, *absent))


def _entry(fault: ProgramFault) -> ProgramFaultEntry:
    message = fault.error.message
    note = message if isinstance(message, Note) else Note("invalid-input", message)
    return ProgramFaultEntry(
        step=fault.step,
        field=fault.key or None,
        camera=fault.camera,
        message=message,
        action=fault.error.action or None,
        code=note.code,
        values=dict(note.values),
    )
