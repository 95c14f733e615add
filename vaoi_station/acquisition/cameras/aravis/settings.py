"""The settings of a camera: each is written, read back and compared before the camera is used.

A camera may still have what another program left in it, so a station begins with the user set *Default* and neutral
values for all that changes pictures or times (`families.py`). If a camera ignores a setting, an error names the camera,
the feature, the wanted and the actual value: frames with another exposure or region would be worse than no frames. A
camera may round numbers to the steps of its sensor.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from vaoi_station.acquisition.cameras.aravis import families
from vaoi_station.acquisition.cameras.aravis.families import Neutral, Wanted
from vaoi_station.acquisition.cameras.aravis.features import At, Features, Value, answered
from vaoi_station.acquisition.cameras.aravis.library import glib_error, text_of
from vaoi_station.acquisition.cameras.interface import (
    GAIN_TOLERANCE_DB,
    CameraLimits,
    CameraPtp,
    exposure_tolerance_us,
)
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "FrameBurstStart", "AcquisitionStart")
"""Triggers that give one frame per pulse, in order of preference."""
TRIGGER_WIDTH = "TriggerWidth"
"""The ExposureMode in which a camera exposes for as long as the trigger is high (SFNC)."""
FEATURE_TOLERANCE = 0.01
KEEP = "keep"
"""The `user_set` with which a camera keeps what is in it."""
_WHAT_IT_CAN = "Set what this camera can do in station.toml, or update its firmware."


@dataclass(frozen=True)
class Setting:
    """A feature of a camera and its wanted value."""

    feature: str
    value: Value
    tolerance: float = 0.0
    at: At = ()
    """Where selectors must stand while the feature is written or read."""
    why: str = ""
    """What another value would do to pictures or times."""

    def matches(self, got: object) -> bool:
        """Return whether a value that was read back equals the wanted one, within the tolerance."""
        if isinstance(self.value, bool | str):
            return got == self.value
        return isinstance(got, int | float) and math.isclose(got, self.value, rel_tol=1e-6, abs_tol=self.tolerance)

    @property
    def name(self) -> str:
        """The feature with its selectors, as in `TriggerMode[FrameStart]`."""
        return self.feature + "".join(f"[{entry}]" for _, entry in self.at)


class Gain(NamedTuple):
    """The feature with which a camera sets its gain, and what its values mean."""

    feature: str
    at: At
    db: Callable[[float], float]
    """Value → dB."""
    value: Callable[[float], float]
    """DB → value."""


class Control:
    """Writes and reads the settings of one open camera. Its errors name camera, feature, value and limits."""

    def __init__(self, camera: Any, name: str) -> None:
        """Take an open camera, and its name in messages."""
        self.camera, self.name = camera, name
        self.features = Features(camera)

    @cached_property
    def vendor(self) -> str:
        """The name of its vendor."""
        return text_of(self.camera.get_vendor_name)

    @cached_property
    def model(self) -> str:
        """The name of its model."""
        return text_of(self.camera.get_model_name)

    def put(self, setting: Setting) -> None:
        """Write a setting, read it back and compare; DeviceError if it is refused or ignored."""
        if self.features.kind(setting.feature) is None:
            raise self._lacks(f"has no feature {setting.feature}, which is to be {setting.value!r}")
        value = self._within_limits(setting)
        try:
            self.features.select(setting.at)
            self.features.write(setting.feature, value)
        except glib_error() as error:
            why = f"; otherwise {setting.why}" if setting.why else ""
            offered = self.features.entries(setting.feature)
            if offered and setting.value not in offered:
                why = f"; it offers {', '.join(offered)}"
            raise DeviceError(
                f"{self.name}: refuses {setting.name} = {setting.value!r} ({error_text(error)}){why}.",
                action=_WHAT_IT_CAN,
                code="setting-refused",
            ) from error
        self.compare(setting)

    def compare(self, setting: Setting) -> None:
        """Read a setting from the camera; raise DeviceError if its value is not the wanted one."""
        try:
            got = self.read(setting)
        except glib_error() as error:
            raise DeviceError(
                f"{self.name}: {setting.name} cannot be read ({error_text(error)}).", code="setting-unread"
            ) from error
        if not setting.matches(got):
            why = f"; otherwise {setting.why}" if setting.why else ""
            raise DeviceError(
                f"{self.name}: ignores a setting: {setting.name} was set to {setting.value!r}, but reads {got!r}{why}.",
                action=_WHAT_IT_CAN,
                code="setting-ignored",
            )

    def read(self, setting: Setting) -> Value:
        """Return the value that a setting has in the camera; GLib.Error if it cannot be read."""
        self.features.select(setting.at)
        return self.features.read(setting.feature)

    def execute(self, command: str, action: str) -> None:
        """Execute a command and wait for its end; DeviceError if the camera refuses it."""
        try:
            self.features.execute(command)
        except glib_error() as error:
            raise DeviceError(
                f"{self.name}: refuses {command} ({error_text(error)}).", action=action, code="setting-refused"
            ) from error

    def exposure(self) -> tuple[str, float]:
        """Return the feature with which the camera sets its exposure, and its unit in µs."""
        for feature in families.EXPOSURES:
            if self.features.kind(feature) in ("float", "integer"):
                unit = self.features.unit(feature)
                if unit not in families.TIME_UNITS_US:
                    raise self._lacks(f"states {feature} in {unit!r}, which is no unit of time")
                return feature, families.TIME_UNITS_US[unit]
        if re.search(families.MICROSECONDS, self.features.text(families.RAW_EXPOSURE)):
            return families.RAW_EXPOSURE, 1.0
        raise self._lacks(f"has no exposure to set ({', '.join(families.EXPOSURES)})")

    def gain(self) -> Gain | None:
        """Return how the camera sets its gain; None if it has no gain, or none whose dB are known."""
        features = self.features
        entry = next((e for e in ("All", "AnalogAll") if e in features.entries("GainSelector")), None)
        at: At = (("GainSelector", entry),) if entry else ()
        with answered():
            features.select(at)
        for feature in ("Gain", "GainRaw", "GainAbs"):
            if features.kind(feature) == "float" and features.has(feature):
                limits = features.limits(feature)
                in_db = features.unit(feature).casefold() == "db" or families.make_of(self.vendor).gain_in_db
                if in_db or limits is None or limits[0] < 1:
                    return Gain(feature, at, lambda value: value, lambda db: db)
                # SFNC: "an amplification factor", as of ViewWorks_VNP604.
                return Gain(feature, at, lambda value: 20 * math.log10(value), lambda db: 10 ** (db / 20))
        formula = families.raw_gain(self.vendor, self.model)
        if formula is None or not features.has("GainRaw"):
            return None
        low = (features.limits("GainRaw") or (0.0, 0.0, 1.0))[0]
        return Gain(
            "GainRaw",
            at,
            lambda value: formula.db(value, low),
            lambda db: float(round(formula.count(db, low))),
        )

    def _within_limits(self, setting: Setting) -> Value:
        """Return the value, on a step of the camera if its tolerance permits that; DeviceError if it cannot be."""
        if isinstance(setting.value, bool | str):
            return setting.value
        limits = None
        # A camera that does not state its limits refuses a value beyond them itself.
        with answered():
            self.features.select(setting.at)
            limits = self.features.limits(setting.feature)
        if limits is None or limits[:2] == (0, 0):  # nothing is stated
            return setting.value
        low, high, step = limits
        if low > high or step < 0:
            raise DeviceError(
                f"{self.name}: its description contradicts itself: {setting.name} has the limits {low:g} … {high:g}, "
                f"step {step:g}.",
                action="Update its firmware, or use another camera.",
                code="description-wrong",
            )
        slack = max(setting.tolerance, 1e-6 * abs(setting.value))
        nearest = setting.value if step <= 1 else int(low + round((setting.value - low) / step) * step)
        off_step = abs(nearest - setting.value) > setting.tolerance or nearest > max(high, setting.value)
        if not low - slack <= setting.value <= high + slack or off_step:
            steps = f", step {step:g}" if step > 1 else ""
            raise DeviceError(
                f"{self.name}: {setting.name} = {setting.value:g} is outside of what the camera states: "
                f"{low:g} … {high:g}{steps}.",
                action=_WHAT_IT_CAN,
                code="setting-beyond-limits",
            )
        return nearest

    def _lacks(self, what: str) -> DeviceError:
        return DeviceError(f"{self.name}: {what}.", action=_WHAT_IT_CAN, code="feature-absent")


def write(camera: Any, name: str, settings: Iterable[Setting]) -> None:
    """Write settings in their order and read each back at once; raise DeviceError if one is refused or ignored."""
    control = Control(camera, name)
    for setting in settings:
        control.put(setting)


def apply(camera: Any, config: CameraConfig) -> str:
    """Bring a camera into a known state: its user set, neutral values, the settings of station.toml, the trigger.

    Return what is doubtful about its colours; an empty text if nothing is.
    """
    control = Control(camera, config.label)
    with _reporting(control):
        _load_user_set(control, config)
        wanted: dict[tuple[str, At], Setting] = {}
        for setting in _known_start(control, config):
            wanted.pop((setting.feature, setting.at), None)  # what is written last is compared last
            wanted[setting.feature, setting.at] = setting
        # All are compared once more at the end: writing one feature may change another (Aravis #1045). What
        # station.toml names has the last word.
        named = {feature for feature, _ in config.named_features}
        for setting in wanted.values():
            if setting.feature not in named:
                control.compare(setting)
        _require_global_shutter(control)
        return _doubtful_colours(control, config)


def apply_exposure(camera: Any, config: CameraConfig) -> None:
    """Write exposure and gain to a camera whose other settings are in force, read them back and compare."""
    control = Control(camera, config.label)
    with _reporting(control):
        for setting in _exposure(control, config):
            control.put(setting)


def deviations(control: Control, config: CameraConfig) -> Iterator[tuple[Setting, Value]]:
    """Yield neutral settings that a camera does not have now, with what it has. Only selectors are written."""
    try:
        at = _require_trigger(control)
        control.features.select(at)
        line = trigger_line(config, control.vendor, control.features.entries("TriggerSource"))
        entries = {"TriggerSelector": tuple(entry for _, entry in at), "LineSelector": (line,)}
        named = {feature for feature, _ in config.named_features}
        for setting, got in _neutral(control, (*_before_format(config), *families.PICTURE, *AT_THE_TRIGGER), entries):
            if not setting.matches(got) and setting.feature not in named:
                yield setting, got
    finally:
        control.features.restore_selection()


def frame_trigger(triggers: Sequence[str]) -> str | None:
    """Return which of a camera's triggers gives one frame per pulse of a wire; None if there is none."""
    return next((name for name in FRAME_TRIGGERS if name in triggers), None)


def trigger_line(config: CameraConfig, vendor: str, sources: Sequence[str]) -> str:
    """Return the input that triggers a camera: the configured one, else that of its make among its sources."""
    return config.trigger_line or families.usual_line(vendor, sources)


def limits_of(camera: Any) -> CameraLimits:
    """Return the limits that a camera states for exposure and gain, and how many sets its sequencer has."""
    control = Control(camera, "")
    exposure, gain, sets = None, None, None
    # A camera that does not state a limit refuses a value beyond it when the line is armed.
    with contextlib.suppress(DeviceError), answered():
        feature, unit_us = control.exposure()
        exposure = _bounds(control.features.limits(feature), lambda value: value * unit_us)
    with answered():
        known = control.gain()
        gain = _bounds(control.features.limits(known.feature), known.db) if known else (0.0, 0.0)
    with answered():
        if control.features.has("SequencerSetSelector"):
            low, high, _ = control.features.limits("SequencerSetSelector") or (0, -1, 1)
            sets = int(high - low) + 1
    return CameraLimits(exposure, gain, sets)


def has_ptp(features: Features) -> bool:
    """Return whether a camera has PTP (IEEE 1588)."""
    return any(map(features.has, families.PTP))


def ptp_of(camera: Any) -> CameraPtp:
    """Return what a camera states of its PTP now."""
    features = Features(camera)
    for command in filter(features.has, families.PTP_LATCHES):
        # Its end is not awaited, as by `execute`: others wait for the camera, perhaps between two boards.
        with answered():
            camera.get_device().execute_command(command)
    state, offset_ns = "", None
    with answered():
        state = next((str(features.read(name)) for name in families.PTP_STATES if features.has(name)), "")
    with answered():
        offset_ns = next((int(features.read(name)) for name in families.PTP_OFFSETS if features.has(name)), None)
    return CameraPtp(state, offset_ns)


def error_text(error: Exception) -> str:
    """Return the message of a GLib error without its domain."""
    return str(getattr(error, "message", error)).rstrip(".")


# --- the settings, in the order in which they are written


AT_THE_TRIGGER = (*families.ON_THE_LINE, *families.ON_THE_TRIGGER)


def _before_format(config: CameraConfig) -> tuple[Neutral, ...]:
    return (*families.MODES, *(families.PTP_ON if config.ptp else families.PTP_OFF), *families.GEOMETRY)


def _load_user_set(control: Control, config: CameraConfig) -> None:
    if config.user_set == KEEP:
        return
    offered = control.features.entries("UserSetSelector")
    if config.user_set in offered and control.features.has("UserSetLoad"):
        control.put(Setting("UserSetSelector", config.user_set))
        control.execute("UserSetLoad", 'Set user_set = "keep" in station.toml for this camera.')
        control.features.forget_selection()
    elif config.user_set != CameraConfig.model_fields["user_set"].default:
        raise DeviceError(
            f"{control.name}: has no user set {config.user_set!r}; it has {', '.join(offered) or 'none'}.",
            action="Set user_set in station.toml to one of these, or remove it.",
            code="feature-absent",
        )


def _known_start(control: Control, config: CameraConfig) -> Iterator[Setting]:
    """Write everything in an order that all makes accept; yield what was written or found to be so."""
    features = control.features
    # PGR_Flea3_GE_28S4C: which trigger is selected follows from ExposureMode, and cannot be written. At other makes, a
    # trigger that is on may lock it, so a refusal counts only below.
    if "Timed" in features.entries("ExposureMode") and features.read("ExposureMode") != "Timed":
        with answered():
            features.write("ExposureMode", "Timed")
    yield from _neutralised(control, families.TRIGGER_CONTROL)
    trigger = _require_trigger(control)
    # Not compared again at the end: in PGR_GS3_U3_51S5M, selecting another trigger switches ExposureMode.
    for _ in _neutralised(control, families.TRIGGERS):
        pass
    features.select(trigger)
    if features.has("AcquisitionMode"):
        yield from _put(control, [Setting("AcquisitionMode", "Continuous")])
    if config.ptp and not has_ptp(features):
        raise DeviceError(
            f"{control.name}: cannot follow a PTP master: it has none of {', '.join(families.PTP)}.",
            action="Remove ptp = true of this camera from station.toml: the station compares its clock itself.",
            code="feature-absent",
        )
    yield from _neutralised(control, _before_format(config))
    yield from _put(control, _format_and_region(control, config))
    yield from _neutralised(control, families.PICTURE)
    _require_global_shutter(control, put=True)
    yield from _put(control, _exposure(control, config))
    yield from _put(control, _named_features(control, config))
    features.forget_selection()  # named features may be selectors
    features.select(trigger)
    line = _require_line(control, config)
    at_line = {"TriggerSelector": tuple(entry for _, entry in trigger), "LineSelector": (line,)}
    yield from _put(control, [Setting("TriggerSource", line, at=trigger)])
    if features.has("TriggerActivation") and features.entries("TriggerActivation") != ("None",):  # PCO1600: by a switch
        yield from _put(control, [Setting("TriggerActivation", "RisingEdge", at=trigger)])
    yield from _neutralised(control, AT_THE_TRIGGER, at_line)
    yield from _put(control, [Setting("TriggerMode", "On", at=trigger)])


def _put(control: Control, settings: Iterable[Setting]) -> Iterator[Setting]:
    for setting in settings:
        control.put(setting)
        yield setting


def _neutralised(
    control: Control, rows: Iterable[Neutral], entries: Mapping[str, tuple[str, ...]] = {}
) -> Iterator[Setting]:
    """Write what is not neutral; yield all settings that the camera has."""
    for setting, got in _neutral(control, rows, entries):
        if not setting.matches(got):
            control.put(setting)
        yield setting


def _neutral(
    control: Control, rows: Iterable[Neutral], entries: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[Setting, Value]]:
    """Yield neutral settings of the features that a camera has, and their present values."""
    features = control.features
    for row in rows:
        if any(features.has(switch) for switch in row.unless) or not any(map(features.kind, row.names)):
            continue
        chosen = entries[row.per] if row.per in entries else features.entries(row.per) if row.per else ()
        for entry in chosen or ("",):
            at: At = ((row.per, entry),) if entry and features.has(row.per) else ()
            for name in row.names:
                # What cannot be read cannot be left over from another program: descriptions declare features that
                # their camera lacks.
                with answered():
                    features.select(at)
                    if not features.has(name):
                        continue
                    value = _in_kind(features, name, row.value)
                    if value is not None:
                        tolerance = FEATURE_TOLERANCE if isinstance(value, float) else 0.0
                        yield Setting(name, value, tolerance, at, row.why), features.read(name)


def _in_kind(features: Features, name: str, wanted: Wanted) -> Value | None:
    """Return a wanted value in the kind of a feature; None if the feature cannot express it."""
    kind = features.kind(name)
    if kind == "choice":
        offered = features.entries(name)
        if wanted is families.OFF:
            accepted: Sequence[str] = families.OFF_ENTRIES
        elif wanted is families.ON:
            accepted = families.ON_ENTRIES
        else:
            accepted = wanted if isinstance(wanted, tuple) else (f"X{wanted:g}", f"{wanted:g}")
        return next((entry for entry in accepted if entry in offered), None)
    if kind == "boolean":
        return wanted is families.ON
    if kind not in ("integer", "float") or isinstance(wanted, tuple):
        return None
    low, high, _ = features.limits(name) or (0.0, 0.0, 0.0)
    if low == high:
        return None  # there is no choice
    # A number that is off at 0 is off at its lowest value if it cannot be 0.
    number = low if wanted is families.LEAST else wanted if isinstance(wanted, int | float) else max(low, 0.0)
    return int(number) if kind == "integer" else float(number)


def _format_and_region(control: Control, config: CameraConfig) -> Iterator[Setting]:
    features = control.features
    # Chunk data would follow the pixels in every frame, which then would not fit its slot; a camera with a sequencer
    # states its exposures there.
    if not config.chunk_room_bytes and features.has("ChunkModeActive"):
        yield Setting("ChunkModeActive", False)
    yield Setting("PixelFormat", config.pixel_format)
    # At the corner of the sensor, every size fits; then the region is moved.
    region = (("Width", config.width), ("Height", config.height))
    offsets = (("OffsetX", config.offset_px[0]), ("OffsetY", config.offset_px[1]))
    moved = [(name, wanted) for name, wanted in offsets if wanted or features.has(name)]
    first: dict[str, int] = {}
    for name, _ in moved:
        low, high, _ = features.limits(name) or (0, 0, 1)
        if low < high:
            first[name] = int(low)  # PCO1600 counts from 1
            yield Setting(name, int(low))
    for name, wanted in (*region, *moved):
        yield Setting(name, wanted or first.get(name, 0))


def _exposure(control: Control, config: CameraConfig) -> Iterator[Setting]:
    modes = control.features.entries("ExposureMode")
    if config.exposure_by == "trigger-width":
        if TRIGGER_WIDTH not in modes:
            offered = f"its ExposureMode offers {', '.join(modes)}" if modes else "it has no feature ExposureMode"
            raise DeviceError(
                f"{config.label}: cannot expose for the width of the trigger ({offered}), which the light program "
                f"needs: its rows have different exposures, the first {config.exposure_us:g} µs.",
                action="Give all rows one exposure for this camera, and let on_us of the lights make the difference.",
                code="exposure-mode",
            )
        yield Setting("ExposureMode", TRIGGER_WIDTH)
        yield from registers(control, None, config.gain_db)
        return
    # Cameras have further modes, which station.toml may name.
    if "Timed" in modes and "ExposureMode" not in dict(config.named_features):
        yield Setting("ExposureMode", "Timed")
    yield from registers(control, config.exposure_us, config.gain_db)


def registers(control: Control, exposure_us: float | None, gain_db: float) -> Iterator[Setting]:
    """Yield the settings of an exposure, if there is one, and of a gain."""
    if exposure_us is not None:
        feature, unit_us = control.exposure()
        value = exposure_us / unit_us
        if control.features.kind(feature) == "integer":
            value = round(value)
        yield Setting(feature, value, exposure_tolerance_us(exposure_us) / unit_us)
    gain = control.gain()
    if gain is not None:
        value = gain.value(gain_db)
        near = abs(gain.value(gain_db + GAIN_TOLERANCE_DB) - value)
        kind = control.features.kind(gain.feature)
        yield Setting(gain.feature, int(value) if kind == "integer" else value, near, gain.at)
    elif gain_db:
        limits = control.features.limits("GainRaw") if control.features.has("GainRaw") else None
        has = f"its GainRaw counts {limits[0]:g} … {limits[1]:g} by no known formula" if limits else "it has no gain"
        raise DeviceError(
            f"{control.name}: cannot be set to a gain of {gain_db:g} dB: {has}.",
            action="Set gain_db = 0 in station.toml"
            + (", and GainRaw among its features, as its maker's manual says." if limits else "."),
            code="gain-unknown",
        )


def _named_features(control: Control, config: CameraConfig) -> Iterator[Setting]:
    for feature, value in config.named_features:
        # A selector that is named may stand anywhere from now on.
        control.features.forget_selection()
        number = not isinstance(value, bool | str)
        if number and control.features.kind(feature) == "float":
            yield Setting(feature, float(value), FEATURE_TOLERANCE * abs(float(value)))
        else:
            yield Setting(feature, value)


def _require_trigger(control: Control) -> At:
    """Return the selector of the trigger that gives one frame per pulse; nothing if the camera has only one trigger."""
    features = control.features
    triggers = features.entries("TriggerSelector")
    for name in (name for name in FRAME_TRIGGERS if name in triggers):
        at: At = (("TriggerSelector", name),)
        # Descriptions list triggers that their camera lacks (Basler-scA1400-30gm).
        with answered():
            features.select(at)
            if "On" in features.entries("TriggerMode"):
                return at
    if not triggers and "On" in features.entries("TriggerMode"):
        return ()
    raise DeviceError(
        f"{control.name}: can be triggered by {', '.join(triggers) or 'nothing'} only, not by a wire.",
        action="Use a camera with a trigger input.",
        code="camera-without-trigger",
    )


def _require_line(control: Control, config: CameraConfig) -> str:
    sources = control.features.entries("TriggerSource")
    line = trigger_line(config, control.vendor, sources)
    if line not in sources:
        raise DeviceError(
            f"{control.name}: has no trigger input {line or 'by wire'}; it has {', '.join(sources) or 'none'}.",
            action='Set trigger_line = "…" in station.toml to one of these.',
            code="camera-without-input",
        )
    return line


def _require_global_shutter(control: Control, *, put: bool = False) -> None:
    """Raise DeviceError if a camera exposes its lines one after the other; with `put`, switch its global shutter on."""
    features = control.features
    for name in families.SHUTTERS:
        if features.kind(name) != "choice" or not features.has(name):
            continue
        got, offered = str(features.read(name)), features.entries(name)
        if not offered:
            continue  # FLIR_BFLY_PGE_13H2M declares shutters that it does not have
        best = next((entry for entry in families.GLOBAL_SHUTTERS if entry in offered), None)
        if got in families.GLOBAL_SHUTTERS:
            continue
        if best is None or not put:
            raise DeviceError(
                f"{control.name}: {name} is {got}; it offers {', '.join(offered)}. Its lines are exposed one after the "
                "other, and boards are filmed while they move.",
                action="Use a camera with a global shutter.",
                code="rolling-shutter",
            )
        control.put(Setting(name, best, why="lines would be exposed one after the other"))


def _doubtful_colours(control: Control, config: CameraConfig) -> str:
    """Return a warning if a camera states another order of its colours than its pixel format; else an empty text.

    It is no error: frames come in the pixel format, and some cameras may state the filter of their unmirrored sensor.
    """
    if not config.pixel_format.startswith("Bayer"):
        return ""
    with answered():
        if control.features.has("PixelColorFilter"):
            # Basler-scA1400-30gm has Bayer_RG, FLIR_ORX_10G_245S8M has BayerRG.
            stated = str(control.features.read("PixelColorFilter")).replace("_", "")
            order = config.pixel_format[: len("BayerRG")]
            if stated in ("BayerRG", "BayerGR", "BayerGB", "BayerBG") and stated != order:
                return (
                    f"It states the colours {stated} (PixelColorFilter), but its frames are read as "
                    f"{config.pixel_format}: if red and blue, or green, are exchanged in its pictures, set "
                    f"pixel_format to {config.pixel_format.replace(order, stated)}, and do not mirror its picture."
                )
    return ""


@contextlib.contextmanager
def _reporting(control: Control) -> Iterator[None]:
    """Turn GLib errors in a `with` block, raised while features are looked up, into a DeviceError."""
    try:
        yield
    except glib_error() as error:
        raise DeviceError(
            f"{control.name}: does not report its features ({error_text(error)}).", code="setting-unread"
        ) from error


def _bounds(stated: tuple[float, float, float] | None, meaning: Callable[[float], float]) -> tuple[float, float] | None:
    """Return a lowest and a highest value; None if they are none, as of a feature without limits."""
    if stated is None or not (math.isfinite(stated[0]) and math.isfinite(stated[1]) and stated[0] < stated[1]):
        return None
    return meaning(stated[0]), meaning(stated[1])
