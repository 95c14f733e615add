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


def test_a_setting_that_is_refused_or_that_the_camera_lacks_is_named() -> None:
    camera = StandInCamera()
    with pytest.raises(DeviceError, match="camera c0: has no feature Sharpness, which is to be 3") as lacking:
        settings.apply(camera, camera_config(features={"Sharpness": 3}))
    assert lacking.value.code == "feature-absent"
    camera.device.features["Sharpness"] = 0
    camera.device.refused.add("Sharpness")
    with pytest.raises(DeviceError, match=r"camera c0: refuses Sharpness = 3 \(Sharpness is locked\)") as refused:
        settings.apply(camera, camera_config(features={"Sharpness": 3}))
    assert refused.value.code == "setting-refused"


@pytest.mark.parametrize(("step", "written"), [(20, 260), (30, 260), (100, None)])
def test_an_exposure_in_steps_is_rounded_within_its_tolerance(step: int, written: int | None) -> None:
    camera = StandInCamera()
    camera.device.features["ExposureTime"] = 1000
    camera.device.bounds["ExposureTime"] = (20, 100_000)
    camera.device.steps["ExposureTime"] = step
    if written is None:
        with pytest.raises(DeviceError, match=r"ExposureTime = 250 is outside of what the camera states: .*, step 100"):
            settings.apply(camera, camera_config(exposure_us=250.0))
    else:
        settings.apply(camera, camera_config(exposure_us=250.0))
        assert camera.device.features["ExposureTime"] == written


@pytest.mark.parametrize(("unit", "taken"), [("uSeconds", True), ("lines", False)])
def test_raw_counts_are_an_exposure_where_the_description_says_that_they_are_us(unit: str, taken: bool) -> None:
    camera = StandInCamera()
    del camera.device.features["ExposureTime"]
    camera.device.features["ExposureTimeRaw"] = 10
    camera.device.units["ExposureTimeRaw"] = unit
    if taken:
        settings.apply(camera, camera_config(exposure_us=250.0))
        assert camera.device.features["ExposureTimeRaw"] == 250
    else:
        with pytest.raises(DeviceError, match="has no exposure to set"):
            settings.apply(camera, camera_config(exposure_us=250.0))


def test_the_corner_of_a_sensor_whose_columns_count_from_one_is_one() -> None:
    """PCO1600."""
    camera = StandInCamera()
    camera.device.features["OffsetX"] = 7
    camera.device.bounds["OffsetX"] = (1, 100)
    settings.apply(camera, camera_config())
    assert camera.device.features["OffsetX"] == 1


def test_a_trigger_without_edges_to_choose_from_is_taken_as_it_is() -> None:
    """PCO1600 has a switch for it."""
    camera = StandInCamera()
    camera.device.features["TriggerActivation"] = "None"
    camera.device.entries["TriggerActivation"] = ("None",)
    settings.apply(camera, camera_config())
    assert ("TriggerActivation", "RisingEdge") not in camera.device.written


def test_a_vendor_that_is_not_written_in_utf_8_is_none() -> None:
    camera = StandInCamera()
    camera.get_vendor_name = b"\xb0\xa2".decode  # type: ignore[method-assign]
    assert settings.Control(camera, "camera c0").vendor == ""


def test_what_counts_from_one_is_off_at_one() -> None:
    camera = StandInCamera()
    camera.device.features["Binning"] = 2
    camera.device.bounds["Binning"] = (1, 4)
    settings.apply(camera, camera_config())
    assert camera.device.features["Binning"] == 1


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


def test_what_another_program_left_is_made_neutral_and_what_is_neutral_is_not_written() -> None:
    camera = StandInCamera()
    camera.device.features |= {
        "TriggerDelay": 500.0, "LUTEnable": True, "ReverseX": False, "Gamma": 0.5, "Sharpness": 7,
        "DefectCorrectStaticEnable": False, "BalanceRatioSelector": "Blue", "BalanceRatio": 2.0,
    }  # fmt: skip
    settings.apply(camera, camera_config())
    features = camera.device.features
    assert (features["TriggerDelay"], features["LUTEnable"], features["Sharpness"]) == (0.0, False, 0)
    assert features["GammaEnable"] is False
    assert features["Gamma"] == 0.5, "it has a switch, which is off"
    assert (features["DefectCorrectStaticEnable"], features["BalanceRatio"]) == (True, 1.0)
    assert "ReverseX" not in dict(camera.device.written)


@pytest.mark.parametrize(("stated", "doubtful"), [("Bayer_GB", True), ("BayerRG", False), ("None", False)])
def test_a_camera_that_states_another_order_of_its_colours_is_doubtful(stated: str, doubtful: bool) -> None:
    camera = StandInCamera()
    camera.device.features["PixelColorFilter"] = stated
    camera.device.entries["PixelFormat"] = ("Mono8", "BayerRG12p")
    warning = settings.apply(camera, camera_config(pixel_format="BayerRG12p"))
    assert ("set pixel_format to BayerGB12p" in warning) == doubtful == bool(warning)
    assert settings.apply(camera, camera_config(pixel_format="Mono8")) == ""


def with_user_sets() -> StandInCamera:
    camera = StandInCamera()
    camera.device.features |= {"UserSetSelector": "UserSet1", "UserSetLoad": None}
    camera.device.entries["UserSetSelector"] = ("Default", "UserSet1")
    return camera


@pytest.mark.parametrize(
    ("user_set", "loaded"), [("Default", ["UserSetLoad"]), ("UserSet1", ["UserSetLoad"]), ("keep", [])]
)
def test_the_user_set_is_loaded_before_everything_else(user_set: str, loaded: list[str]) -> None:
    camera = with_user_sets()
    settings.apply(camera, camera_config(user_set=user_set))
    assert camera.device.commands == loaded
    if loaded:
        assert camera.device.written[0] == ("UserSetSelector", user_set)


def test_features_are_written_in_their_order_and_a_selector_twice() -> None:
    camera = StandInCamera()
    camera.device.features |= {"LineSelector": "Line0", "LineDebouncerTimeAbs": 0.0}
    camera.device.entries["LineSelector"] = ("Line0", "Line1")
    tables = ({"LineSelector": "Line1", "LineDebouncerTimeAbs": 5}, {"LineSelector": "Line0", "GammaEnable": True})
    settings.apply(camera, camera_config(features=tables))
    named = [(name, value) for name, value in camera.device.written if name.startswith(("Line", "GammaEnable"))]
    assert named == [
        ("GammaEnable", False), ("LineSelector", "Line1"), ("LineDebouncerTimeAbs", 5.0), ("LineSelector", "Line0"),
        ("GammaEnable", True),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("features", "entries", "bounds", "code", "words"),
    [
        ({}, {}, {"Width": (32, 64)}, "setting-beyond-limits", "Width = 16 is outside of .* 32 … 64"),
        ({}, {}, {"Width": (64, 8)}, "description-wrong", "contradicts itself: Width has the limits 64 … 8"),
        (
            {"SensorShutterMode": "Rolling"}, {"SensorShutterMode": ("Rolling", "GlobalReset")}, {},
            "rolling-shutter", "SensorShutterMode is Rolling; it offers Rolling, GlobalReset",
        ),
        ({}, {"TriggerSource": ("Software",)}, {}, "camera-without-input", "no trigger input by wire; it has Software"),
        ({}, {"TriggerMode": ("Off",)}, {}, "camera-without-trigger", "not by a wire"),
    ],
)  # fmt: skip
def test_a_camera_that_cannot_do_what_is_planned_is_refused_with_its_limits(
    features: dict[str, Any], entries: dict[str, tuple[str, ...]], bounds: dict[str, Any], code: str, words: str
) -> None:
    camera = StandInCamera()
    camera.device.features |= features
    camera.device.entries |= entries
    camera.device.bounds |= bounds
    with pytest.raises(DeviceError, match=words) as refused:
        settings.apply(camera, camera_config())
    assert refused.value.code == code
    assert refused.value.message.startswith("camera c0: ")


def test_a_gain_that_is_counted_by_no_known_formula_is_left_alone_or_refused_with_its_range() -> None:
    camera = StandInCamera("Basler")
    del camera.device.features["Gain"]
    camera.device.features["GainRaw"] = 77
    camera.device.bounds["GainRaw"] = (33, 512)
    settings.apply(camera, camera_config())
    assert camera.device.features["GainRaw"] == 77
    with pytest.raises(DeviceError, match=r"a gain of 6 dB: its GainRaw counts 33 … 512") as refused:
        settings.apply(camera, camera_config(gain_db=6.0))
    assert refused.value.code == "gain-unknown"


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
