"""Program the sequencer of a camera (SFNC): sets of exposure and gain, of which every frame uses the next one.

The camera advances with the start of every frame, without a message of this computer, so that a set belongs to a row
as long as the camera answers every pulse. Each frame states what it was exposed with (`chunks`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import glib_error
from vaoi_station.acquisition.cameras.aravis.settings import (
    Setting,
    compare,
    error_text,
    exposure_settings,
    feature_setting,
    sequencer_off_settings,
    write_and_compare,
)
from vaoi_station.acquisition.cameras.aravis.trigger import recipe_for
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

MODE, CONFIGURATION = "SequencerMode", "SequencerConfigurationMode"
SELECTOR, NEXT, SOURCE, SAVE = "SequencerSetSelector", "SequencerSetNext", "SequencerTriggerSource", "SequencerSetSave"
NEEDED = (MODE, CONFIGURATION, SELECTOR, NEXT, SOURCE, SAVE)
"""Features without which a camera cannot be given a sequence."""
SOURCES = ("FrameStart", "ExposureStart", "FrameEnd", "ExposureEnd")
"""Entries of SequencerTriggerSource that come once per frame, in order of preference."""
SEQUENCED = ("ExposureTime", "Gain")
"""Features that every set holds."""
_INSTEAD = "Let the on-time of the LEDs (on_us) make the difference between rows, or use a camera with a sequencer."


def missing_features(camera: Any) -> tuple[str, ...]:
    """Return the features of a sequencer that a camera does not have."""
    device = camera.get_device()
    return tuple(feature for feature in NEEDED if not device.is_feature_available(feature))


def program(camera: Any, config: CameraConfig, sequence: Sequence[tuple[float, float]]) -> None:
    """Write a sequence of sets, read every set back and compare, and switch the sequencer on.

    The acquisition must be stopped, and the sequencer must be off.

    Args:
        camera: the `Aravis.Camera`.
        config: its configuration.
        sequence: exposure (µs) and gain (dB) of the sets, which follow one another in a circle.

    Raises:
        DeviceError: the camera has no such sequencer, or refuses or ignores a setting.
    """
    device = camera.get_device()
    source = require_sequencer(camera, config, sequence)
    _write(config, feature_setting(device, CONFIGURATION, "On"))
    _select_features(camera, config)
    for number in range(len(sequence)):
        for setting in _set_settings(camera, sequence, number, source):
            _write(config, setting)
        _execute(camera, config, SAVE)
    # Only what is loaded again is known to have been saved: until then the settings read back are those just written.
    if device.is_feature_available("SequencerSetLoad"):
        for number in range(len(sequence)):
            selected, *settings = _set_settings(camera, sequence, number, source)
            _write(config, selected)
            _execute(camera, config, "SequencerSetLoad")
            for setting in settings:
                compare(config.label, setting)
    if device.is_feature_available("SequencerSetStart"):
        _write(config, feature_setting(device, "SequencerSetStart", _first_set(camera)))
    _write(config, feature_setting(device, CONFIGURATION, "Off"))
    _write(config, feature_setting(device, MODE, "On"))


def rewind(camera: Any, config: CameraConfig) -> None:
    """Begin the sequence anew with its first set. The acquisition must be stopped.

    Raises:
        DeviceError: the camera refuses or ignores it.
    """
    # The start set is taken when the sequencer is switched on; a mere start of the acquisition does it at some makes.
    for mode in ("Off", "On"):
        _write(config, feature_setting(camera.get_device(), MODE, mode))


def switch_off(camera: Any, config: CameraConfig) -> None:
    """Switch a sequencer off, if the camera has one. The acquisition must be stopped.

    Raises:
        DeviceError: the camera refuses or ignores it.
    """
    for setting in sequencer_off_settings(camera.get_device()):
        _write(config, setting)


def require_sequencer(camera: Any, config: CameraConfig, sequence: Sequence[tuple[float, float]]) -> str:
    """Return the source that advances the sequence. Raise DeviceError with numbers if the camera cannot hold it."""
    if missing := missing_features(camera):
        raise DeviceError(
            f"{config.label}: has no sequencer ({', '.join(missing)} missing), which exposure_by states and the "
            f"light program needs: it has {len(sequence)} different steps for this camera.",
            action=_INSTEAD,
            code="sequencer-absent",
        )
    low, high = camera.get_integer_bounds(SELECTOR)
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
    offered = camera.dup_available_enumerations_as_strings(SOURCE)
    source = next((name for name in SOURCES if name in offered), None)
    if source is None:
        raise _beyond(config, f"its sequencer advances by {', '.join(offered) or 'nothing'}, not once per frame")
    return source


def _beyond(config: CameraConfig, why: str) -> DeviceError:
    message = f"{config.label}: cannot follow the light program: {why}."
    return DeviceError(message, action=_INSTEAD, code="sequencer-limits")


def _select_features(camera: Any, config: CameraConfig) -> None:
    """Let the sets hold exposure and gain. Cameras without a choice hold what they hold, which is compared later."""
    device = camera.get_device()
    if not device.is_feature_available("SequencerFeatureSelector"):
        return
    offered = camera.dup_available_enumerations_as_strings("SequencerFeatureSelector")
    for feature in SEQUENCED:
        if feature in offered:
            _write(config, feature_setting(device, "SequencerFeatureSelector", feature))
            enabled = feature_setting(device, "SequencerFeatureEnable", True)
            # Where a feature always belongs to the sets, its switch can be read only.
            if not enabled.matches(enabled.read()):
                _write(config, enabled)


def _set_settings(camera: Any, sequence: Sequence[tuple[float, float]], number: int, source: str) -> list[Setting]:
    """Return the settings of one set, in their order; the first one selects the set."""
    device, first = camera.get_device(), _first_set(camera)
    settings = [
        feature_setting(device, SELECTOR, first + number),
        *exposure_settings(camera, *sequence[number]),
    ]
    if device.is_feature_available("SequencerPathSelector"):
        path = recipe_for(camera.get_vendor_name() or "").sequencer_path
        settings.append(feature_setting(device, "SequencerPathSelector", path))
    return [
        *settings,
        feature_setting(device, NEXT, first + (number + 1) % len(sequence)),
        feature_setting(device, SOURCE, source),
    ]


def _first_set(camera: Any) -> int:
    return int(camera.get_integer_bounds(SELECTOR)[0])


def _write(config: CameraConfig, setting: Setting) -> None:
    write_and_compare(config.label, setting)


def _execute(camera: Any, config: CameraConfig, command: str) -> None:
    try:
        camera.get_device().execute_command(command)
    except glib_error() as error:
        raise DeviceError(
            f"{config.label}: refuses {command} ({error_text(error)}).",
            action="Update its firmware, or set exposure_by in station.toml to another way.",
            code="setting-refused",
        ) from error
