"""A sequence is written set by set, read back from what was saved, and refused with numbers."""

from __future__ import annotations

from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera, camera_config
from vaoi_station.acquisition.cameras.aravis import settings
from vaoi_station.errors import DeviceError

pytestmark = pytest.mark.usefixtures("_stand_in")

CONFIG = camera_config(exposure_by="sequencer")
STEPS = ((300.0, 0.0), (90.0, 0.0), (90.0, 6.0))


def sequenced(vendor: str = "Acme", **changes: Any) -> StandInCamera:
    """Return a camera with a sequencer of four sets."""
    camera = StandInCamera(vendor)
    features = {
        "SequencerMode": "On", "SequencerConfigurationMode": "Off", "SequencerSetSelector": 0, "SequencerSetNext": 0,
        "SequencerTriggerSource": "Off", "SequencerSetSave": 0, "SequencerSetLoad": 0, "SequencerSetStart": 3,
        "SequencerPathSelector": 0, "SequencerFeatureSelector": "Gain", "SequencerFeatureEnable": False,
    }  # fmt: skip
    camera.device.features |= features | changes
    camera.bounds = {"SequencerSetSelector": (0, 3)}
    camera.choices = {
        "SequencerTriggerSource": ["Off", "FrameEnd", "FrameStart"],
        "SequencerFeatureSelector": ["ExposureTime", "Gain"],
    }
    return camera


def refusal(camera: StandInCamera, steps: tuple[tuple[float, float], ...] = STEPS) -> DeviceError:
    with pytest.raises(DeviceError) as caught:
        settings.program_sequencer(camera, CONFIG, steps)
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
    settings.program_sequencer(camera, CONFIG, STEPS)
    assert [(s["ExposureTime"], s["Gain"], s["SequencerSetNext"]) for s in kept.values()] == [
        (300.0, 0.0, 1), (90.0, 0.0, 2), (90.0, 6.0, 0),
    ]  # fmt: skip
    assert {s["SequencerTriggerSource"] for s in kept.values()} == {"FrameStart"}
    assert device.features["SequencerFeatureEnable"] is True
    assert (device.features["SequencerSetStart"], device.features["SequencerMode"]) == (0, "On")
    assert device.features["SequencerConfigurationMode"] == "Off"


def test_the_path_is_that_of_the_make() -> None:
    for vendor, path in (("Basler", 1), ("Acme", 0)):
        camera = sequenced(vendor, SequencerPathSelector=5)
        del camera.device.features["SequencerSetLoad"]
        settings.program_sequencer(camera, CONFIG, STEPS)
        assert camera.device.features["SequencerPathSelector"] == path


def test_a_set_that_was_not_saved_is_noticed() -> None:
    error = refusal(sequenced())
    assert error.code == "setting-ignored"
    assert "ExposureTime was set to 300.0, but reads 90.0" in error.message


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


def test_a_camera_without_a_sequencer_or_its_signal_is_refused() -> None:
    bare = StandInCamera()
    assert settings.missing_features(bare) == settings.SEQUENCER
    assert (refusal(bare).code, "3 different steps" in refusal(bare).message) == ("sequencer-absent", True)
    camera = sequenced()
    camera.choices["SequencerTriggerSource"] = ["Off", "Line1"]
    assert "its sequencer advances by Off, Line1, not once per frame" in refusal(camera).message
    camera = sequenced()
    del camera.device.features["Gain"]
    assert "it has no gain to set" in refusal(camera).message


def test_it_begins_anew_when_it_is_switched_on_again() -> None:
    camera = sequenced()
    settings.rewind_sequencer(camera, CONFIG)
    assert camera.device.written == [("SequencerMode", "Off"), ("SequencerMode", "On")]


def test_it_is_switched_off_after_its_configuration_and_only_if_it_is_on() -> None:
    camera = sequenced(SequencerConfigurationMode="On")
    for _ in range(2):
        settings.switch_sequencer_off(camera, CONFIG)
    assert camera.device.written == [("SequencerConfigurationMode", "Off"), ("SequencerMode", "Off")]
