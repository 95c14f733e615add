"""Settings are written, read back and compared, in the order that cameras need."""

from __future__ import annotations

from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera, StandInError, camera_config
from vaoi_station.acquisition.cameras.aravis import sequencer, settings
from vaoi_station.acquisition.cameras.aravis.stream import ChunkReader
from vaoi_station.acquisition.cameras.interface import StatedExposure
from vaoi_station.errors import DeviceError

pytestmark = pytest.mark.usefixtures("_stand_in")


def test_the_triggers_are_off_while_everything_else_is_set_and_the_frames_trigger_is_on_at_last() -> None:
    camera = StandInCamera()
    camera.device.features["TriggerMode"] = camera.device.modes["FrameStart"] = "On"
    settings.apply(camera, camera_config())
    written = [pair for pair in camera.device.written if pair[0].startswith("Trigger")]
    assert written[:4] == [
        ("TriggerSelector", "FrameStart"), ("TriggerMode", "Off"),
        ("TriggerSelector", "AcquisitionStart"), ("TriggerMode", "Off"),
    ]  # fmt: skip
    assert [pair for pair in written if pair[0] != "TriggerSelector"][-1] == ("TriggerMode", "On")
    assert camera.device.features["TriggerSelector"] == "FrameStart"


def test_a_refused_setting_is_named() -> None:
    camera = StandInCamera()
    with pytest.raises(
        DeviceError, match=r"camera c0: refuses Sharpness = 3 \(node Sharpness is not found\)"
    ) as refused:
        settings.apply(camera, camera_config(features={"Sharpness": 3}))
    assert refused.value.code == "setting-refused"


@pytest.mark.parametrize(
    ("modes", "words"), [([], "it has no feature ExposureMode"), (["Timed"], "its ExposureMode offers Timed")]
)
def test_a_camera_that_cannot_expose_for_the_width_is_refused(modes: list[str], words: str) -> None:
    camera = StandInCamera()
    if modes:
        camera.device.features["ExposureMode"] = "Timed"
        camera.device.entries["ExposureMode"] = tuple(modes)
    wanted = camera_config(exposure_by="trigger-width", exposure_us=80.0)
    with pytest.raises(DeviceError, match=rf"width of the trigger \({words}\).* the first 80 µs") as caught:
        settings.apply_exposure(camera, wanted)
    assert caught.value.code == "exposure-mode"


CONFIG = camera_config(exposure_by="sequencer")
STEPS = ((300.0, 0.0), (90.0, 0.0), (90.0, 6.0))


def sequenced(vendor: str = "Acme", **changes: Any) -> StandInCamera:
    """Return a camera with a sequencer of four sets."""
    camera = StandInCamera(vendor)
    features = {
        "SequencerMode": "On", "SequencerConfigurationMode": "Off", "SequencerSetSelector": 0, "SequencerSetNext": 0,
        "SequencerTriggerSource": "Off", "SequencerSetSave": None, "SequencerSetLoad": None, "SequencerSetStart": 3,
        "SequencerPathSelector": 0, "SequencerFeatureSelector": "Gain", "SequencerFeatureEnable": False,
    }  # fmt: skip
    camera.device.features |= features | changes
    camera.device.bounds["SequencerSetSelector"] = (0, 3)
    camera.device.entries |= {
        "SequencerTriggerSource": ("Off", "FrameEnd", "FrameStart"),
        "SequencerFeatureSelector": ("ExposureTime", "Gain"),
    }
    return camera


def refusal(camera: StandInCamera, steps: tuple[tuple[float, float], ...] = STEPS) -> DeviceError:
    with pytest.raises(DeviceError) as caught:
        sequencer.program_sequencer(camera, CONFIG, steps)
    return caught.value


def test_every_set_is_saved_with_its_exposure_gain_and_next_set() -> None:
    camera = sequenced()
    kept: dict[int, dict[str, Any]] = {}
    device, execute = camera.device, camera.device.execute_command

    def keep(command: str) -> None:
        execute(command)
        names = ("ExposureTime", "Gain", "SequencerSetNext", "SequencerTriggerSource")
        if command == "SequencerSetSave":
            kept[device.features["SequencerSetSelector"]] = {name: device.features[name] for name in names}
        else:
            device.features |= kept[device.features["SequencerSetSelector"]]

    device.execute_command = keep  # type: ignore[method-assign]
    sequencer.program_sequencer(camera, CONFIG, STEPS)
    assert [(s["ExposureTime"], s["Gain"], s["SequencerSetNext"]) for s in kept.values()] == [
        (300.0, 0.0, 1), (90.0, 0.0, 2), (90.0, 6.0, 0),
    ]  # fmt: skip
    assert {s["SequencerTriggerSource"] for s in kept.values()} == {"FrameStart"}
    assert device.features["SequencerFeatureEnable"] is True
    assert (device.features["SequencerSetStart"], device.features["SequencerMode"]) == (0, "On")
    assert device.features["SequencerConfigurationMode"] == "Off"


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (((300.0, 0.0),) * 5, "its sequencer holds 4 sets, but the light program needs 5"),
        (
            ((300.0, 0.0), (10.0, 0.0)),
            "its exposure has the limits 20 … 100000 µs, but step 1 of the light program has",
        ),
        (((300.0, 0.0), (300.0, 30.0)), "its gain has the limits 0 … 24 dB, but step 1 of the light program has 30 dB"),
    ],
)
def test_what_the_sequencer_cannot_hold_is_refused_with_numbers(
    steps: tuple[tuple[float, float], ...], words: str
) -> None:
    error = refusal(sequenced(), steps)
    assert error.code == "sequencer-limits"
    assert words in error.message


class StandInParser:
    """A parser that knows the exposure only, or both."""

    def __init__(self, **values: float) -> None:
        self.values = values

    def get_float_value(self, _buffer: object, name: str) -> float:
        if name not in self.values:
            raise StandInError(f"node {name} is not found")
        return self.values[name]


def test_what_a_frame_states_is_read_or_not_known() -> None:
    camera = StandInCamera()
    for values, stated in (
        ({"ChunkExposureTime": 90.0, "ChunkGain": 6.0}, StatedExposure(90.0, 6.0)),
        ({"ChunkExposureTime": 90.0}, None),
    ):
        camera.create_chunk_parser = lambda values=values: StandInParser(**values)  # type: ignore[attr-defined]
        assert ChunkReader(camera, 40).read(object()) == stated
    del camera.device.features["Gain"]
    assert ChunkReader(camera, 40).read(object()) == StatedExposure(90.0, None)
