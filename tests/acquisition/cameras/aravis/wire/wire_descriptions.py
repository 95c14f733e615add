"""Cameras of makers, from their descriptions: the station opens them, and every frame is proven."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage, noise
from tests.needs import DESCRIPTIONS, need_descriptions
from vaoi_station.config import StationConfig
from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.first_values import Sensor


@pytest.mark.parametrize("name", ["Allied_Vision_1800_U-811m", "FLIR_BFLY_PGE_13H2M"])
def test_a_frame_of_a_camera_with_its_makers_description_arrives(
    name: str, tmp_path: Path, opened: Callable[[StationConfig], Stage]
) -> None:
    need_descriptions()
    text = gzip.decompress((DESCRIPTIONS / f"{name}.xml.gz").read_bytes()).decode("utf-8-sig")
    camera = Camera("127.0.0.2", text, serial="REAL", sensor=Sensor(WIDTH, HEIGHT))
    try:
        stage = opened(station_config(tmp_path, [camera_config(address=camera.address, width=WIDTH, height=HEIGHT)]))
        stage.load()
        assert camera.expose(noise(1).tobytes()) == 1
        arrival = stage.arrival()
        assert (arrival.complete, arrival.frame_id) == (True, 1), arrival.fault
        assert (stage.ring.memory(arrival.slot) == noise(1)).all()
        assert camera.exposure_us == pytest.approx(250)
        stage.close()
    finally:
        camera.close()
