"""Write every setting of a camera, read it back and compare it before the camera is used.

If a camera ignores a setting, an error names the camera, the feature, the wanted and the actual value: frames with
another exposure or region would be worse than no frames. A camera may round numbers to the steps of its sensor.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error
from vaoi_station.acquisition.cameras.aravis.trigger import FRAME_TRIGGERS, recipe_for
from vaoi_station.acquisition.cameras.interface import (
    EXPOSURE_TOLERANCE,
    EXPOSURE_TOLERANCE_US,
    GAIN_TOLERANCE_DB,
    CameraLimits,
)
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

TRIGGER_WIDTH = "TriggerWidth"
"""The ExposureMode in which a camera exposes for as long as the trigger is high (SFNC)."""
FEATURE_TOLERANCE = 0.01
"""Accepted relative difference of a feature that station.toml sets by name."""

Value = bool | int | float | str
_KINDS = {bool: "boolean", int: "integer", float: "float", str: "string"}
"""Python type → its word in the names of Aravis' functions, as in `set_integer_feature_value`."""


@dataclass(frozen=True)
class Setting:
    """A feature of a camera, its wanted value, and the functions that write and read it."""

    feature: str
    wanted: Value | tuple[int, ...]
    write: Callable[[], object]
    read: Callable[[], Any]
    tolerance: float = 0.0
    transient: bool = False
    """Whether a later setting of the same feature replaces this setting, so that it cannot be compared at the end."""

    def matches(self, got: object) -> bool:
        """Return whether a value that was read back equals the wanted one, within the tolerance."""
        if isinstance(self.wanted, bool | str | tuple):
            return got == self.wanted
        return isinstance(got, int | float) and math.isclose(got, self.wanted, rel_tol=1e-6, abs_tol=self.tolerance)


def apply(camera: Any, config: CameraConfig) -> None:
    """Write, read back and compare the settings of the picture, of named features and of the trigger.

    The settings of the packets are written by `Connection.configure`.

    Raises:
        DeviceError: the camera refuses or ignores a setting.
    """
    for part in (_picture, _named_features, _trigger):
        settings = list(_with_device_errors(config.label, part(camera, config)))
        for setting in settings:
            write_and_compare(config.label, setting)
        # All are compared once more at the end: writing one feature may change another (Aravis #1045).
        for setting in settings:
            if not setting.transient:
                compare(config.label, setting)


def apply_exposure(camera: Any, config: CameraConfig) -> None:
    """Write exposure and gain to a camera whose other settings are in force, read them back and compare.

    Raises:
        DeviceError: the camera refuses or ignores one of them.
    """
    for setting in list(_with_device_errors(config.label, _exposure(camera, config))):
        write_and_compare(config.label, setting)


def write_and_compare(name: str, setting: Setting) -> None:
    """Write a setting, read it back at once, and raise DeviceError if the camera refuses or ignores it."""
    try:
        setting.write()
    except glib_error() as error:
        raise DeviceError(
            f"{name}: refuses {setting.feature} = {setting.wanted!r} ({error_text(error)}).",
            action="Set what this camera can do in station.toml, or update its firmware.",
            code="setting-refused",
        ) from error
    compare(name, setting)


def compare(name: str, setting: Setting) -> None:
    """Read a setting from the camera and raise DeviceError if its value is not the wanted one."""
    try:
        got = setting.read()
    except glib_error() as error:
        raise DeviceError(
            f"{name}: {setting.feature} cannot be read ({error_text(error)}).", code="setting-unread"
        ) from error
    if not setting.matches(got):
        raise DeviceError(
            f"{name}: ignores a setting: {setting.feature} was set to {setting.wanted!r}, but reads {got!r}.",
            action="Set what this camera can do in station.toml, or update its firmware.",
            code="setting-ignored",
        )


def error_text(error: Exception) -> str:
    """Return the message of a GLib error without its domain."""
    return str(getattr(error, "message", error)).rstrip(".")


def _with_device_errors(name: str, settings: Iterator[Setting]) -> Iterator[Setting]:
    """Yield settings from a generator; turn each GLib error that the generator raises into a DeviceError."""
    try:
        yield from settings
    except glib_error() as error:
        raise DeviceError(f"{name}: does not report its features ({error_text(error)}).") from error


def _picture(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    """Yield the settings of the picture: binning, format, region, exposure and gain; automatic controls are off."""
    x, y = config.offset_px
    region = (x, y, config.width, config.height)
    device = camera.get_device()
    # An earlier program may have left the sequencer on, which then would overwrite exposure and gain.
    yield from sequencer_off_settings(device)
    for feature in ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical"):
        if device.is_feature_available(feature):
            yield feature_setting(device, feature, 1)
    yield Setting(
        "PixelFormat",
        config.pixel_format,
        lambda: camera.set_pixel_format_from_string(config.pixel_format),
        camera.get_pixel_format_as_string,
    )
    # Chunk data would follow the pixels in every frame, which then would not fit its slot. A clock that is synchronised
    # (PTP, under its names in SFNC 2 and GigE Vision) may jump within a run; the station fits every clock by itself.
    for feature in ("ChunkModeActive", "PtpEnable", "GevIEEE1588"):
        # A camera with a sequencer states exposures in its chunk data, for which its slots have room.
        if device.is_feature_available(feature) and not (feature == "ChunkModeActive" and config.chunk_room_bytes):
            yield feature_setting(device, feature, False)
    yield Setting("Region", region, lambda: camera.set_region(*region), lambda: _region(camera))
    # Turned off before exposure and gain are set: while an automatic control is on, cameras refuse or overwrite values.
    for feature in ("ExposureAuto", "GainAuto", "BlackLevelAuto", "GammaEnable"):
        if device.is_feature_available(feature):
            yield feature_setting(device, feature, False if feature == "GammaEnable" else "Off")
    yield from _exposure(camera, config)


def sequencer_off_settings(device: Any) -> Iterator[Setting]:
    """Yield the settings that switch a sequencer off; none if the camera has no sequencer, or if it is off.

    Cameras whose sets were never programmed refuse any write to SequencerMode, so that nothing is written in vain. The
    configuration ends first: while it is on, SequencerMode is locked.
    """
    for feature in ("SequencerConfigurationMode", "SequencerMode"):
        if device.is_feature_available(feature):
            off = feature_setting(device, feature, "Off")
            if not off.matches(off.read()):
                yield off


def _exposure(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    """Yield the settings of exposure and gain."""
    device, by_trigger = camera.get_device(), config.exposure_by == "trigger-width"
    has_modes = device.is_feature_available("ExposureMode")
    if by_trigger:
        _require_trigger_width(
            config, camera.dup_available_enumerations_as_strings("ExposureMode") if has_modes else ()
        )
        yield feature_setting(device, "ExposureMode", TRIGGER_WIDTH)
    elif (
        has_modes
        and "ExposureMode" not in config.features
        and device.get_string_feature_value("ExposureMode") == TRIGGER_WIDTH
    ):
        # Written only to end the other mode: cameras have further modes, which station.toml does not know.
        yield feature_setting(device, "ExposureMode", "Timed")
    yield from exposure_settings(camera, None if by_trigger else config.exposure_us, config.gain_db)


def exposure_settings(camera: Any, exposure_us: float | None, gain_db: float) -> Iterator[Setting]:
    """Yield the settings of the registers of exposure, unless it is None, and of gain, if the camera has one."""
    if exposure_us is not None:
        yield Setting(
            "ExposureTime",
            exposure_us,
            lambda: camera.set_exposure_time(exposure_us),
            camera.get_exposure_time,
            max(EXPOSURE_TOLERANCE_US, EXPOSURE_TOLERANCE * exposure_us),
        )
    if gain_db or camera.is_gain_available():
        yield Setting("Gain", gain_db, lambda: camera.set_gain(gain_db), camera.get_gain, GAIN_TOLERANCE_DB)


def _require_trigger_width(config: CameraConfig, modes: Sequence[str]) -> None:
    """Raise DeviceError if a camera cannot expose for as long as the trigger is high."""
    if TRIGGER_WIDTH not in modes:
        offered = f"its ExposureMode offers {', '.join(modes)}" if modes else "it has no feature ExposureMode"
        raise DeviceError(
            f"{config.label}: cannot expose for the width of the trigger ({offered}), which the light program needs: "
            f"its rows have different exposures, the first {config.exposure_us:g} µs.",
            action="Give all rows one exposure for this camera, and let on_us of the lights make the difference.",
            code="exposure-mode",
        )


def _region(camera: Any) -> tuple[int, int, int, int]:
    region = camera.get_region()
    return region.x, region.y, region.width, region.height


def _named_features(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    """Yield the settings of those features that station.toml sets by name, in the order of that file."""
    device = camera.get_device()
    for feature, value in config.features.items():
        yield feature_setting(device, feature, value)


def _trigger(camera: Any, config: CameraConfig) -> Iterator[Setting]:
    """Yield the settings that make the camera send one frame per trigger pulse, by the recipe for its make."""
    device = camera.get_device()
    recipe = recipe_for(camera.get_vendor_name() or "")
    line = config.trigger_line or recipe.line
    if device.is_feature_available("AcquisitionMode"):
        yield feature_setting(device, "AcquisitionMode", "Continuous")
    if device.is_feature_available("AcquisitionFrameRateEnable"):
        yield feature_setting(device, "AcquisitionFrameRateEnable", False)
    triggers = camera.dup_available_triggers()
    ours = next((name for name in FRAME_TRIGGERS if name in triggers), None)
    if ours is None:
        raise DeviceError(
            f"{config.label}: can be triggered by {', '.join(triggers) or 'nothing'} only, not by a wire.",
            action="Use a camera with a trigger input.",
        )
    # Any other active trigger would delay or multiply frames. These settings are transient, because all triggers share
    # one selector: read back later, every setting would show the value of the trigger selected last.
    for other in triggers:
        if other != ours:
            yield replace(feature_setting(device, "TriggerSelector", other), transient=True)
            yield replace(feature_setting(device, "TriggerMode", "Off"), transient=True)
    yield feature_setting(device, "TriggerSelector", ours)
    yield replace(feature_setting(device, "TriggerMode", "Off" if recipe.off_while_changing else "On"), transient=True)
    yield feature_setting(device, "TriggerSource", line)
    yield feature_setting(device, "TriggerActivation", "RisingEdge")
    for feature, value in recipe.extra:
        if device.is_feature_available(feature) and device.is_enumeration_entry_available(feature, value):
            yield feature_setting(device, feature, value)
    yield feature_setting(device, "TriggerMode", "On")


def limits_of(camera: Any) -> CameraLimits:
    """Return the limits that a camera states for exposure and gain, and how many sets its sequencer has."""
    device, sets = camera.get_device(), "SequencerSetSelector"
    exposure, gain, numbers = None, None, None
    # A camera that does not state a limit refuses a value beyond it when the line is armed.
    with contextlib.suppress(glib_error()):
        exposure = _bounds(camera.get_exposure_time_bounds())
    with contextlib.suppress(glib_error()):
        gain = _bounds(camera.get_gain_bounds()) if camera.is_gain_available() else (0.0, 0.0)
    with contextlib.suppress(glib_error()):
        if device.is_feature_available(sets):
            low, high = camera.get_integer_bounds(sets)
            numbers = high - low + 1
    return CameraLimits(exposure, gain, numbers)


def _bounds(found: Sequence[float]) -> tuple[float, float] | None:
    """Return a lowest and a highest value; None if they are none, as of a feature without limits."""
    low, high = found
    return (float(low), float(high)) if math.isfinite(low) and math.isfinite(high) and low < high else None


def feature_setting(device: Any, feature: str, value: Value) -> Setting:
    """Return the setting of a feature, given by its GenICam name. A float feature also accepts a whole number."""
    if type(value) is int and isinstance(device.get_feature(feature), aravis().GcFloat):
        value = float(value)
    kind = _KINDS[type(value)]
    write, read = (getattr(device, f"{way}_{kind}_feature_value") for way in ("set", "get"))
    tolerance = FEATURE_TOLERANCE * abs(value) if isinstance(value, float) else 0.0
    return Setting(feature, value, lambda: write(feature, value), lambda: read(feature), tolerance)
