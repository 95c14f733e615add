"""Chunk data are switched on for exposure and gain only, and a camera that cannot state them is refused."""

from __future__ import annotations

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera, StandInError, camera_config
from vaoi_station.acquisition.cameras.aravis import settings
from vaoi_station.acquisition.cameras.aravis.stream import ChunkReader
from vaoi_station.acquisition.cameras.interface import StatedExposure
from vaoi_station.errors import DeviceError

pytestmark = pytest.mark.usefixtures("_stand_in")

CONFIG = camera_config(exposure_by="sequencer")


class StandInParser:
    """A parser that knows the exposure only, or both."""

    def __init__(self, **values: float) -> None:
        self.values = values

    def get_float_value(self, _buffer: object, name: str) -> float:
        if name not in self.values:
            raise StandInError(f"node {name} is not found")
        return self.values[name]


def test_exposure_and_gain_are_switched_on() -> None:
    camera = StandInCamera()
    camera.device.features |= {"ChunkSelector": "Image", "ChunkEnable": False}
    camera.choices["ChunkSelector"] = ["Image", "Gain", "ExposureTime"]
    settings.switch_chunks_on(camera, CONFIG)
    assert camera.device.written == [
        ("ChunkModeActive", True),
        ("ChunkSelector", "ExposureTime"),
        ("ChunkEnable", True),
        ("ChunkSelector", "Gain"),
        ("ChunkEnable", True),
    ]


def test_a_camera_that_cannot_state_its_exposure_is_refused() -> None:
    camera = StandInCamera()
    for offered, words in (([], "ChunkSelector offers nothing"), (["Gain"], "cannot state ExposureTime as chunk data")):
        camera.device.features["ChunkSelector"] = "Image"
        camera.choices["ChunkSelector"] = offered
        with pytest.raises(DeviceError, match=words) as caught:
            settings.switch_chunks_on(camera, CONFIG)
        assert caught.value.code == "sequencer-absent"


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
