"""Cameras of makers, from their descriptions: a station puts right what was left in them, and proves their frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage, noise
from tests.gige.descriptions import FilmingLine
from tests.gige.leftovers import leave_all, survivors
from tests.gige.referee import Referee
from tests.needs import DESCRIPTIONS
from vaoi_station.config import StationConfig
from vaoi_station.rig.gige.camera import Camera

EXPOSURE_US = 250.0


def test_nothing_that_was_left_in_a_camera_survives(
    plug: Callable[[str], Camera], tmp_path: Path, opened: Callable[[StationConfig], Stage]
) -> None:
    """The station does not load the user set, which would hide a feature that it forgets."""
    names = sorted(path.name.removesuffix(".xml.gz") for path in DESCRIPTIONS.glob("*.xml.gz"))
    cameras = {name: plug(name) for name in names}
    differences = [f"{name}: {what}" for name in names for what in Referee(cameras[name]).differences(cameras[name])]
    assert differences == [], "the stand-in itself reads the descriptions as the reference does"
    formats = {name: str(camera.value("PixelFormat")) for name, camera in cameras.items()}
    left = {name: leave_all(camera) for name, camera in cameras.items()}
    assert all(len(leftovers) > 10 for leftovers in left.values())
    configured = [
        camera_config(
            name=name.replace("_", "-").lower(), address=camera.address, width=WIDTH, height=HEIGHT,
            pixel_format=formats[name], exposure_us=EXPOSURE_US, user_set="keep",
        )
        for name, camera in cameras.items()
    ]  # fmt: skip
    stage = opened(station_config(tmp_path, configured))
    stage.load()
    for number, (name, camera) in enumerate(cameras.items()):
        assert camera.expose(noise(number).tobytes()) == 1, name
    arrivals = sorted((stage.arrival() for _ in cameras), key=lambda arrival: arrival.camera)
    for number, arrival in enumerate(arrivals):
        assert (arrival.complete, arrival.frame_id) == (True, 1), f"{configured[number].name}: {arrival.fault}"
        assert (stage.ring.memory(arrival.slot) == noise(number)).all()
    assert [f"{name}: {what}" for name in cameras for what in survivors(cameras[name], left[name])] == []
    for name, camera in cameras.items():
        referee = Referee(camera)
        assert [referee.value(f) for f in ("Width", "Height", "PixelFormat")] == [WIDTH, HEIGHT, formats[name]], name
        exposure = next(f for f in ("ExposureTime", "ExposureTimeAbs") if referee.has(f))
        assert referee.value(exposure) == pytest.approx(EXPOSURE_US, rel=0.01), name
    scout = Referee(cameras["Basler-scA1400-30gm"])
    scout.select({"TriggerSelector": "FrameStart"})  # its other implementation of triggers has no FrameStart
    assert scout.value("TriggerMode") == "On"


def test_the_user_set_default_replaces_one_that_an_earlier_program_has_saved(
    plug: Callable[[str], Camera], tmp_path: Path, opened: Callable[[StationConfig], Stage]
) -> None:
    camera = plug("AVT_Mako_G234B")
    black_level = camera.value("BlackLevel")
    leave_all(camera)
    camera.put("BlackLevel", 7)  # the station sets no black level
    camera.save_as_power_on_set("UserSet1")
    camera.boot()
    assert camera.value("BlackLevel") == 7 != black_level, "it is loaded at power-on"
    stage = opened(station_config(tmp_path, [camera_config(address=camera.address, width=WIDTH, height=HEIGHT)]))
    stage.load()
    assert camera.expose(noise(1).tobytes()) == 1
    assert stage.arrival().complete
    assert Referee(camera).value("BlackLevel") == black_level


def test_a_board_is_filmed_by_three_makers_cameras_and_every_frame_is_proven(
    plug: Callable[[str], Camera], tmp_path: Path
) -> None:
    """Their clocks count in 8 ns, in ns, and in ns of a USB3 camera."""
    cameras = [plug(name) for name in ("AVT_Mako_G234B", "Basler-a2A2600-20gmBAS", "PGR_BFS_U3_51S5M")]
    configured = [
        camera_config(name=f"c{k}", address=camera.address, width=WIDTH, height=HEIGHT)
        for k, camera in enumerate(cameras)
    ]
    line = FilmingLine(tmp_path, cameras, configured)
    try:
        assert line.proven(line.film(rows=3)) == 9
    finally:
        line.close()
