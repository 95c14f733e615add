"""The sequencer of a camera: sets of exposure and gain, of which every frame uses the next one; and its proof."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from vaoi_station.acquisition.cameras.aravis import families
from vaoi_station.acquisition.cameras.aravis.features import Features
from vaoi_station.acquisition.cameras.aravis.settings import Control, Setting, limits_of, registers
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

Sets = Sequence[tuple[float, float]]
"""Exposure (µs) and gain (dB) of the sets of a sequencer, which follow one another in a circle."""
SEQUENCER = (
    "SequencerMode", "SequencerConfigurationMode", "SequencerSetSelector", "SequencerSetNext",
    "SequencerTriggerSource", "SequencerSetSave",
)  # fmt: skip
SEQUENCER_SOURCES = ("FrameStart", "ExposureStart", "FrameEnd", "ExposureEnd")
"""Entries of SequencerTriggerSource that come once per frame, in order of preference."""
_INSTEAD = "Let the on-time of the LEDs (on_us) make the difference between rows, or use a camera with a sequencer."
_OTHERWISE = "Update its firmware, or set exposure_by in station.toml to another way."


def missing_features(features: Features) -> tuple[str, ...]:
    """Return the features of a sequencer that a camera does not have."""
    return tuple(feature for feature in SEQUENCER if not features.has(feature))


def switch_chunks_on(camera: Any, config: CameraConfig) -> None:
    """Let each frame state exposure and, if the camera has one, gain behind its pixels (chunk data)."""
    control = Control(camera, config.label)
    offered = control.features.entries("ChunkSelector") if control.features.has("ChunkModeActive") else ()
    wanted = ["ExposureTime", *(["Gain"] if control.gain() else [])]
    if missing := [name for name in wanted if name not in offered]:
        raise DeviceError(
            f"{config.label}: its frames cannot state {' and '.join(missing)} as chunk data (ChunkSelector offers "
            f"{', '.join(offered) or 'nothing'}), without which the exposures of its sequencer are not proven.",
            action='Set exposure_by = "trigger-width" or "register" in station.toml for this camera.',
            code="sequencer-absent",
        )
    control.put(Setting("ChunkModeActive", True))
    for name in wanted:
        control.put(Setting("ChunkEnable", True, at=(("ChunkSelector", name),)))


def program_sequencer(camera: Any, config: CameraConfig, sequence: Sets) -> None:
    """Write a sequence of sets, read every set back, and switch the sequencer on.

    The acquisition must be stopped, and the sequencer must be off.
    """
    control, source = Control(camera, config.label), require_sequencer(camera, config, sequence)
    features = control.features
    control.put(Setting("SequencerConfigurationMode", "On"))
    _select_sequenced(control)
    sets = [list(_set(control, sequence, number, source)) for number in range(len(sequence))]
    for settings in sets:
        for setting in settings:
            control.put(setting)
        control.execute("SequencerSetSave", _OTHERWISE)
    # Only what is loaded again is known to have been saved: until then the settings read back are those just written.
    if features.has("SequencerSetLoad"):
        for selected, *settings in sets:
            control.put(selected)
            control.execute("SequencerSetLoad", _OTHERWISE)
            for setting in settings:
                control.compare(setting)
    if features.has("SequencerSetStart"):
        control.put(Setting("SequencerSetStart", _first_set(control)))
    control.put(Setting("SequencerConfigurationMode", "Off"))
    control.put(Setting("SequencerMode", "On"))


def rewind_sequencer(camera: Any, config: CameraConfig) -> None:
    """Begin the sequence anew with its first set. The acquisition must be stopped."""
    # The start set is taken when the sequencer is switched on; a mere start of the acquisition does it at some makes.
    control = Control(camera, config.label)
    control.put(Setting("SequencerMode", "Off"))
    control.put(Setting("SequencerMode", "On"))


def switch_sequencer_off(camera: Any, config: CameraConfig) -> None:
    """Switch a sequencer off, if the camera has one. The acquisition must be stopped."""
    control = Control(camera, config.label)
    # Cameras whose sets were never programmed refuse any write to SequencerMode, so nothing is written in vain. The
    # configuration ends first: while it is on, SequencerMode is locked.
    for feature in ("SequencerConfigurationMode", "SequencerMode"):
        off = Setting(feature, "Off")
        if control.features.has(feature) and not off.matches(control.read(off)):
            control.put(off)


def require_sequencer(camera: Any, config: CameraConfig, sequence: Sets) -> str:
    """Return the source that advances the sequence. Raise DeviceError with numbers if the camera cannot hold it."""
    control = Control(camera, config.label)
    if missing := missing_features(control.features):
        raise DeviceError(
            f"{config.label}: has no sequencer ({', '.join(missing)} missing), which exposure_by states and the "
            f"light program needs: it has {len(sequence)} different steps for this camera.",
            action=_INSTEAD,
            code="sequencer-absent",
        )
    limits = limits_of(camera)
    if limits.sets is not None and len(sequence) > limits.sets:
        held = limits.sets
        raise _beyond(config, f"its sequencer holds {held} sets, but the light program needs {len(sequence)}")
    if control.gain() is None and any(gain_db for _, gain_db in sequence):
        raise _beyond(config, "it has no gain to set, but the light program changes it")
    bounds = (("exposure", "µs", limits.exposure_us), ("gain", "dB", limits.gain_db))
    for number, step in enumerate(sequence):
        for value, (name, unit, stated) in zip(step, bounds, strict=True):
            if stated is not None and not stated[0] <= value <= stated[1]:
                has = f"its {name} has the limits {stated[0]:g} … {stated[1]:g} {unit}"
                raise _beyond(config, f"{has}, but step {number} of the light program has {value:g} {unit}")
    offered = control.features.entries("SequencerTriggerSource")
    source = next((name for name in SEQUENCER_SOURCES if name in offered), None)
    if source is None:
        raise _beyond(config, f"its sequencer advances by {', '.join(offered) or 'nothing'}, not once per frame")
    return source


def _beyond(config: CameraConfig, why: str) -> DeviceError:
    message = f"{config.label}: cannot follow the light program: {why}."
    return DeviceError(message, action=_INSTEAD, code="sequencer-limits")


def _select_sequenced(control: Control) -> None:
    """Let the sets hold exposure and gain. Cameras without a choice hold what they hold, which is compared later."""
    offered = control.features.entries("SequencerFeatureSelector")
    for feature in ("ExposureTime", "Gain"):
        enabled = Setting("SequencerFeatureEnable", True, at=(("SequencerFeatureSelector", feature),))
        # Where a feature always belongs to the sets, its switch can be read only.
        if feature in offered and not enabled.matches(control.read(enabled)):
            control.put(enabled)


def _set(control: Control, sequence: Sets, number: int, source: str) -> Iterator[Setting]:
    """Yield the settings of one set; the first one selects the set."""
    first = _first_set(control)
    yield Setting("SequencerSetSelector", first + number)
    yield from registers(control, *sequence[number])
    if control.features.has("SequencerPathSelector"):
        yield Setting("SequencerPathSelector", families.make_of(control.vendor).sequencer_path)
    yield Setting("SequencerSetNext", first + (number + 1) % len(sequence))
    yield Setting("SequencerTriggerSource", source)


def _first_set(control: Control) -> int:
    return int((control.features.limits("SequencerSetSelector") or (0, 0, 1))[0])
