"""The settings of a camera as a list of (feature, value): each is written, read back and compared before it is used.

If a camera ignores a setting, an error names the camera, the feature, the wanted and the actual value: frames with
another exposure or region would be worse than no frames. A camera may round numbers to the steps of its sensor.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error
from vaoi_station.acquisition.cameras.interface import GAIN_TOLERANCE_DB, CameraLimits, exposure_tolerance_us
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

Sets = Sequence[tuple[float, float]]
"""Exposure (µs) and gain (dB) of the sets of a sequencer, which follow one another in a circle."""
Value = bool | int | float | str | tuple[int, ...]

FRAME_TRIGGERS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
"""Triggers that give one frame per pulse, in order of preference."""
TRIGGER_WIDTH = "TriggerWidth"
"""The ExposureMode in which a camera exposes for as long as the trigger is high (SFNC)."""
FEATURE_TOLERANCE = 0.01
SEQUENCER = (
    "SequencerMode", "SequencerConfigurationMode", "SequencerSetSelector", "SequencerSetNext",
    "SequencerTriggerSource", "SequencerSetSave",
)  # fmt: skip
SEQUENCER_SOURCES = ("FrameStart", "ExposureStart", "FrameEnd", "ExposureEnd")
"""Entries of SequencerTriggerSource that come once per frame, in order of preference."""
_INSTEAD = "Let the on-time of the LEDs (on_us) make the difference between rows, or use a camera with a sequencer."


@dataclass(frozen=True)
class Make:
    """What the cameras of one make need that others do not."""

    line: str = "Line0"
    off_while_changing: bool = False
    """Whether the camera refuses to change TriggerSource while TriggerMode is On (Aravis #1045)."""
    extra: tuple[tuple[str, str], ...] = ()
    """(feature, value) of further settings, written if the camera has them."""
    sequencer_path: int = 0
    """The path of a sequencer that leads from set to set."""


_FLIR = Make(off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),))
MAKES = {
    "flir": _FLIR,
    "point grey": _FLIR,
    "teledyne": _FLIR,
    # Path 0 of Basler's sequencers only leads back to set 0 (ace U, "Sequencer").
    "basler": Make("Line1", sequencer_path=1),
    "lucid": Make("Line2", extra=(("TriggerOverlap", "PreviousFrame"),)),
    "aravis": Make(),
}
"""The quirks of each make, given by the beginning of its vendor's name in lower case; the longest one counts."""
GENERIC = Make(off_while_changing=True)
"""An unknown make. Cameras of all makes accept that the mode is off while the source changes."""


def make_of(vendor: str) -> Make:
    """Return the quirks of a vendor's cameras; the generic ones if the vendor is not known."""
    name = vendor.casefold()
    start = max((start for start in MAKES if name.startswith(start)), key=len, default="")
    return MAKES.get(start, GENERIC)


@dataclass(frozen=True)
class Setting:
    """A feature of a camera and its wanted value."""

    feature: str
    value: Value
    tolerance: float = 0.0
    shared: bool = False
    """Whether a later setting of the same feature replaces this one, so that it cannot be compared at the end."""

    def matches(self, got: object) -> bool:
        """Return whether a value that was read back equals the wanted one, within the tolerance."""
        if isinstance(self.value, bool | str | tuple):
            return got == self.value
        return isinstance(got, int | float) and math.isclose(got, self.value, rel_tol=1e-6, abs_tol=self.tolerance)


_BY_ARAVIS = {
    "PixelFormat": ("set_pixel_format_from_string", "get_pixel_format_as_string"),
    "ExposureTime": ("set_exposure_time", "get_exposure_time"),
    "Gain": ("set_gain", "get_gain"),
    "Region": ("set_region", "get_region"),
    "GevSCPSPacketSize": ("gv_set_packet_size", "gv_get_packet_size"),
    "GevSCPD (ns)": ("gv_set_packet_delay", "gv_get_packet_delay"),
}
"""Features that functions of Aravis write and read, which know the names and units of older cameras."""
_KINDS = {bool: "boolean", int: "integer", float: "float", str: "string"}
"""Python type → its word in the names of Aravis' functions, as in `set_integer_feature_value`."""


def frame_trigger(triggers: Sequence[str]) -> str | None:
    """Return which of a camera's triggers gives one frame per pulse of a wire; None if there is none."""
    return next((name for name in FRAME_TRIGGERS if name in triggers), None)


def trigger_line(config: CameraConfig, vendor: str) -> str:
    """Return the input that triggers a camera: the configured one, else that of its make."""
    return config.trigger_line or make_of(vendor).line


def write(camera: Any, name: str, settings: Iterable[Setting]) -> None:
    """Write settings in their order and read each back at once; raise DeviceError if one is refused or ignored."""
    for setting in settings:
        try:
            if setting.feature in _BY_ARAVIS:
                values = setting.value if isinstance(setting.value, tuple) else (setting.value,)
                getattr(camera, _BY_ARAVIS[setting.feature][0])(*values)
            else:
                set_value = getattr(camera.get_device(), f"set_{_KINDS[type(setting.value)]}_feature_value")
                set_value(setting.feature, setting.value)
        except glib_error() as error:
            raise DeviceError(
                f"{name}: refuses {setting.feature} = {setting.value!r} ({error_text(error)}).",
                action="Set what this camera can do in station.toml, or update its firmware.",
                code="setting-refused",
            ) from error
        compare(camera, name, [setting])


def compare(camera: Any, name: str, settings: Iterable[Setting]) -> None:
    """Read settings from the camera; raise DeviceError if a value is not the wanted one."""
    for setting in settings:
        try:
            got = _read(camera, setting)
        except glib_error() as error:
            raise DeviceError(
                f"{name}: {setting.feature} cannot be read ({error_text(error)}).", code="setting-unread"
            ) from error
        if not setting.matches(got):
            raise DeviceError(
                f"{name}: ignores a setting: {setting.feature} was set to {setting.value!r}, but reads {got!r}.",
                action="Set what this camera can do in station.toml, or update its firmware.",
                code="setting-ignored",
            )


def apply(camera: Any, config: CameraConfig) -> None:
    """Write, read back and compare the settings of the picture, of named features and of the trigger."""
    for part in (_picture, _named_features, _trigger):
        settings = _listed(config.label, part(camera, config))
        write(camera, config.label, settings)
        # All are compared once more at the end: writing one feature may change another (Aravis #1045).
        compare(camera, config.label, [setting for setting in settings if not setting.shared])


def apply_exposure(camera: Any, config: CameraConfig) -> None:
    """Write exposure and gain to a camera whose other settings are in force, read them back and compare."""
    write(camera, config.label, _listed(config.label, _exposure(camera, config)))


def switch_chunks_on(camera: Any, config: CameraConfig) -> None:
    """Let each frame state exposure and, if the camera has one, gain behind its pixels (chunk data)."""
    offered = (
        camera.dup_available_enumerations_as_strings("ChunkSelector")
        if _has(camera, "ChunkModeActive") and _has(camera, "ChunkSelector")
        else ()
    )
    wanted = ["ExposureTime", *(["Gain"] if camera.is_gain_available() else [])]
    if missing := [name for name in wanted if name not in offered]:
        raise DeviceError(
            f"{config.label}: its frames cannot state {' and '.join(missing)} as chunk data (ChunkSelector offers "
            f"{', '.join(offered) or 'nothing'}), without which the exposures of its sequencer are not proven.",
            action='Set exposure_by = "trigger-width" or "register" in station.toml for this camera.',
            code="sequencer-absent",
        )
    write(camera, config.label, [Setting("ChunkModeActive", True)])
    for name in wanted:
        write(camera, config.label, [Setting("ChunkSelector", name), Setting("ChunkEnable", True)])


def limits_of(camera: Any) -> CameraLimits:
    """Return the limits that a camera states for exposure and gain, and how many sets its sequencer has."""
    exposure, gain, sets = None, None, None
    # A camera that does not state a limit refuses a value beyond it when the line is armed.
    with contextlib.suppress(glib_error()):
        exposure = _bounds(camera.get_exposure_time_bounds())
    with contextlib.suppress(glib_error()):
        gain = _bounds(camera.get_gain_bounds()) if camera.is_gain_available() else (0.0, 0.0)
    with contextlib.suppress(glib_error()):
        if _has(camera, "SequencerSetSelector"):
            low, high = camera.get_integer_bounds("SequencerSetSelector")
            sets = high - low + 1
    return CameraLimits(exposure, gain, sets)


def error_text(error: Exception) -> str:
    """Return the message of a GLib error without its domain."""
    return str(getattr(error, "message", error)).rstrip(".")


# --- the lists of settings, in the order in which they are written


def _picture(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    # An earlier program may have left the sequencer on, which then would overwrite exposure and gain.
    yield from _sequencer_off(camera)
    yield from _available(
        camera, ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical"), 1
    )
    yield Setting("PixelFormat", config.pixel_format)
    # Chunk data would follow the pixels in every frame, which then would not fit its slot; a camera with a sequencer
    # states its exposures there.
    if not config.chunk_room_bytes:
        yield from _available(camera, ("ChunkModeActive",), False)
    # A synchronised clock (PTP, under its names in SFNC 2 and GigE Vision) may jump; the station fits every clock.
    yield from _available(camera, ("PtpEnable", "GevIEEE1588"), False)
    yield Setting("Region", (*config.offset_px, config.width, config.height))
    # Turned off before exposure and gain are set: while an automatic control is on, cameras refuse or overwrite values.
    yield from _available(camera, ("ExposureAuto", "GainAuto", "BlackLevelAuto"), "Off")
    yield from _available(camera, ("GammaEnable",), False)
    yield from _exposure(camera, config)


def _exposure(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    has_modes = _has(camera, "ExposureMode")
    if config.exposure_by == "trigger-width":
        modes = camera.dup_available_enumerations_as_strings("ExposureMode") if has_modes else ()
        if TRIGGER_WIDTH not in modes:
            offered = f"its ExposureMode offers {', '.join(modes)}" if modes else "it has no feature ExposureMode"
            raise DeviceError(
                f"{config.label}: cannot expose for the width of the trigger ({offered}), which the light program "
                f"needs: its rows have different exposures, the first {config.exposure_us:g} µs.",
                action="Give all rows one exposure for this camera, and let on_us of the lights make the difference.",
                code="exposure-mode",
            )
        yield Setting("ExposureMode", TRIGGER_WIDTH)
        yield from _registers(camera, None, config.gain_db)
        return
    # Written only to end the other mode: cameras have further modes, which station.toml does not know.
    if has_modes and "ExposureMode" not in config.features:
        by_width = Setting("ExposureMode", TRIGGER_WIDTH)
        if by_width.matches(_read(camera, by_width)):
            yield Setting("ExposureMode", "Timed")
    yield from _registers(camera, config.exposure_us, config.gain_db)


def _registers(camera: Any, exposure_us: float | None, gain_db: float) -> Iterator[Setting]:
    if exposure_us is not None:
        yield Setting("ExposureTime", exposure_us, exposure_tolerance_us(exposure_us))
    if gain_db or camera.is_gain_available():
        yield Setting("Gain", gain_db, GAIN_TOLERANCE_DB)


def _named_features(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    for feature, value in config.features.items():
        if type(value) is int and isinstance(camera.get_device().get_feature(feature), aravis().GcFloat):
            value = float(value)  # noqa: PLW2901  (a float feature also accepts a whole number)
        yield Setting(feature, value, FEATURE_TOLERANCE * abs(value) if isinstance(value, float) else 0.0)


def _trigger(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    """Yield the settings that make the camera send one frame per trigger pulse."""
    make = make_of(camera.get_vendor_name() or "")
    yield from _available(camera, ("AcquisitionMode",), "Continuous")
    yield from _available(camera, ("AcquisitionFrameRateEnable",), False)
    triggers = camera.dup_available_triggers()
    ours = frame_trigger(triggers)
    if ours is None:
        raise DeviceError(
            f"{config.label}: can be triggered by {', '.join(triggers) or 'nothing'} only, not by a wire.",
            action="Use a camera with a trigger input.",
        )
    # Any other active trigger would delay or multiply frames. All triggers share one selector.
    for other in triggers:
        if other != ours:
            yield Setting("TriggerSelector", other, shared=True)
            yield Setting("TriggerMode", "Off", shared=True)
    yield Setting("TriggerSelector", ours)
    yield Setting("TriggerMode", "Off" if make.off_while_changing else "On", shared=True)
    yield Setting("TriggerSource", trigger_line(config, camera.get_vendor_name() or ""))
    yield Setting("TriggerActivation", "RisingEdge")
    for feature, value in make.extra:
        if _has(camera, feature) and camera.get_device().is_enumeration_entry_available(feature, value):
            yield Setting(feature, value)
    yield Setting("TriggerMode", "On")


# --- the sequencer: sets of exposure and gain, of which every frame uses the next one


def missing_features(camera: Any) -> tuple[str, ...]:
    """Return the features of a sequencer that a camera does not have."""
    return tuple(feature for feature in SEQUENCER if not _has(camera, feature))


def program_sequencer(camera: Any, config: CameraConfig, sequence: Sets) -> None:
    """Write a sequence of sets, read every set back, and switch the sequencer on.

    The acquisition must be stopped, and the sequencer must be off.
    """
    name, source = config.label, require_sequencer(camera, config, sequence)
    write(camera, name, [Setting("SequencerConfigurationMode", "On")])
    _select_sequenced(camera, name)
    sets = [list(_set(camera, sequence, number, source)) for number in range(len(sequence))]
    for settings in sets:
        write(camera, name, settings)
        _execute(camera, config, "SequencerSetSave")
    # Only what is loaded again is known to have been saved: until then the settings read back are those just written.
    if _has(camera, "SequencerSetLoad"):
        for selected, *settings in sets:
            write(camera, name, [selected])
            _execute(camera, config, "SequencerSetLoad")
            compare(camera, name, settings)
    write(camera, name, _available(camera, ("SequencerSetStart",), _first_set(camera)))
    write(camera, name, [Setting("SequencerConfigurationMode", "Off"), Setting("SequencerMode", "On")])


def rewind_sequencer(camera: Any, config: CameraConfig) -> None:
    """Begin the sequence anew with its first set. The acquisition must be stopped."""
    # The start set is taken when the sequencer is switched on; a mere start of the acquisition does it at some makes.
    write(camera, config.label, [Setting("SequencerMode", "Off"), Setting("SequencerMode", "On")])


def switch_sequencer_off(camera: Any, config: CameraConfig) -> None:
    """Switch a sequencer off, if the camera has one. The acquisition must be stopped."""
    write(camera, config.label, _sequencer_off(camera))


def require_sequencer(camera: Any, config: CameraConfig, sequence: Sets) -> str:
    """Return the source that advances the sequence. Raise DeviceError with numbers if the camera cannot hold it."""
    if missing := missing_features(camera):
        raise DeviceError(
            f"{config.label}: has no sequencer ({', '.join(missing)} missing), which exposure_by states and the "
            f"light program needs: it has {len(sequence)} different steps for this camera.",
            action=_INSTEAD,
            code="sequencer-absent",
        )
    low, high = camera.get_integer_bounds("SequencerSetSelector")
    if len(sequence) > high - low + 1:
        raise _beyond(config, f"its sequencer holds {high - low + 1} sets, but the light program needs {len(sequence)}")
    bounds = [("exposure", "µs", camera.get_exposure_time_bounds())]
    if camera.is_gain_available():
        bounds.append(("gain", "dB", camera.get_gain_bounds()))
    elif any(gain_db for _, gain_db in sequence):
        raise _beyond(config, "it has no gain to set, but the light program changes it")
    for number, step in enumerate(sequence):
        for value, (name, unit, (least, most)) in zip(step, bounds, strict=False):
            if not least <= value <= most:
                limits = f"its {name} has the limits {least:g} … {most:g} {unit}"
                raise _beyond(config, f"{limits}, but step {number} of the light program has {value:g} {unit}")
    offered = camera.dup_available_enumerations_as_strings("SequencerTriggerSource")
    source = next((name for name in SEQUENCER_SOURCES if name in offered), None)
    if source is None:
        raise _beyond(config, f"its sequencer advances by {', '.join(offered) or 'nothing'}, not once per frame")
    return source


def _beyond(config: CameraConfig, why: str) -> DeviceError:
    message = f"{config.label}: cannot follow the light program: {why}."
    return DeviceError(message, action=_INSTEAD, code="sequencer-limits")


def _sequencer_off(camera: Any) -> Iterator[Setting]:
    # Cameras whose sets were never programmed refuse any write to SequencerMode, so nothing is written in vain. The
    # configuration ends first: while it is on, SequencerMode is locked.
    for off in _available(camera, ("SequencerConfigurationMode", "SequencerMode"), "Off"):
        if not off.matches(_read(camera, off)):
            yield off


def _select_sequenced(camera: Any, name: str) -> None:
    """Let the sets hold exposure and gain. Cameras without a choice hold what they hold, which is compared later."""
    if not _has(camera, "SequencerFeatureSelector"):
        return
    offered = camera.dup_available_enumerations_as_strings("SequencerFeatureSelector")
    enabled = Setting("SequencerFeatureEnable", True)
    for feature in ("ExposureTime", "Gain"):
        if feature in offered:
            write(camera, name, [Setting("SequencerFeatureSelector", feature)])
            # Where a feature always belongs to the sets, its switch can be read only.
            if not enabled.matches(_read(camera, enabled)):
                write(camera, name, [enabled])


def _set(camera: Any, sequence: Sets, number: int, source: str) -> Iterator[Setting]:
    """Yield the settings of one set; the first one selects the set."""
    first = _first_set(camera)
    yield Setting("SequencerSetSelector", first + number)
    yield from _registers(camera, *sequence[number])
    path = make_of(camera.get_vendor_name() or "").sequencer_path
    yield from _available(camera, ("SequencerPathSelector",), path)
    yield Setting("SequencerSetNext", first + (number + 1) % len(sequence))
    yield Setting("SequencerTriggerSource", source)


def _first_set(camera: Any) -> int:
    return int(camera.get_integer_bounds("SequencerSetSelector")[0])


def _execute(camera: Any, config: CameraConfig, command: str) -> None:
    try:
        camera.get_device().execute_command(command)
    except glib_error() as error:
        raise DeviceError(
            f"{config.label}: refuses {command} ({error_text(error)}).",
            action="Update its firmware, or set exposure_by in station.toml to another way.",
            code="setting-refused",
        ) from error


# --- reading


def _has(camera: Any, feature: str) -> bool:
    return bool(camera.get_device().is_feature_available(feature))


def _available(camera: Any, features: Sequence[str], value: Value) -> Iterator[Setting]:
    """Yield one value for those of the features that the camera has."""
    return (Setting(feature, value) for feature in features if _has(camera, feature))


def _read(camera: Any, setting: Setting) -> Any:
    if setting.feature in _BY_ARAVIS:
        got = getattr(camera, _BY_ARAVIS[setting.feature][1])()
        return (got.x, got.y, got.width, got.height) if setting.feature == "Region" else got
    return getattr(camera.get_device(), f"get_{_KINDS[type(setting.value)]}_feature_value")(setting.feature)


def _listed(name: str, settings: Iterator[Setting]) -> list[Setting]:
    try:
        return list(settings)
    except glib_error() as error:
        raise DeviceError(f"{name}: does not report its features ({error_text(error)}).") from error


def _bounds(stated: Sequence[float]) -> tuple[float, float] | None:
    """Return a lowest and a highest value; None if they are none, as of a feature without limits."""
    low, high = stated
    return (float(low), float(high)) if math.isfinite(low) and math.isfinite(high) and low < high else None
