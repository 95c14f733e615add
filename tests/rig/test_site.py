"""The written station is one that `vaoi serve` reads, with nothing of the rig but addresses."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.config import StationConfig, read_config
from vaoi_station.files import read_board_type, read_calibration
from vaoi_station.rig.devices import build_site
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.scenario import LightSection

ADDRESSES = ("127.0.0.2", "127.0.0.3")


@pytest.fixture
def config(small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path) -> StationConfig:
    return site_of(small, boards[0], tmp_path)


def site_of(scenario: Scenario, board: RenderedBoard, folder: Path) -> StationConfig:
    path = build_site(scenario, board, folder, name="rig-7", addresses=ADDRESSES, port=folder / "trigger", workers=3)
    assert path == folder / "station.toml"
    return read_config(path)


def test_the_files_beside_it_are_those_of_the_twin(small: Scenario, config: StationConfig, tmp_path: Path) -> None:
    twin = Twin(small)
    written = read_calibration(tmp_path / "calibration.json")
    assert written.model_dump_json() == twin.calibration.model_dump_json()
    assert read_board_type(tmp_path / "board-types" / "small.json") == twin.board_type
    assert (config.calibration, config.board_types) == (tmp_path / "calibration.json", tmp_path / "board-types")
    assert config.data == tmp_path / "data"
    assert (config.name, config.workers) == ("rig-7", 3)


def test_the_backends_are_the_real_ones(config: StationConfig, tmp_path: Path) -> None:
    assert [camera.backend for camera in config.cameras] == ["aravis", "aravis"]
    assert [camera.address for camera in config.cameras] == list(ADDRESSES)
    assert (config.controller.backend, config.controller.port) == ("serial", str(tmp_path / "trigger"))
    assert (config.simulation, config.replay) == (None, None)


def test_cameras_have_the_size_and_the_nominal_view_of_the_array(small: Scenario, config: StationConfig) -> None:
    for camera, head in zip(config.cameras, Twin(small).heads, strict=True):
        assert (camera.width, camera.height, camera.exposure_us) == (head.width, head.height, head.exposure_us)
        assert camera.nominal_center_mm == pytest.approx(head.nominal_center_mm)
        assert camera.nominal_px_per_mm == head.nominal_px_per_mm
        assert camera.pixel_format == "Mono8"


def test_sixteen_bits_become_a_wider_pixel_format(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path
) -> None:
    deep = small.model_copy(update={"array": small.array.model_copy(update={"bits": 16})})
    assert {camera.pixel_format for camera in site_of(deep, boards[0], tmp_path).cameras} == {"Mono16"}


def test_leds_are_on_for_the_longest_exposure(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path
) -> None:
    scenario = small.model_copy(
        update={
            "array": small.array.model_copy(update={"exposures_us": (100.0, 400.0)}),
            "line": small.line.model_copy(update={"lights": ("ring", "low")}),
            "lights": {"ring": LightSection(), "low": LightSection()},
        }
    )
    controller = site_of(scenario, boards[0], tmp_path).controller
    assert {name: light.channels for name, light in controller.lights.items()} == {"ring": (0,), "low": (1,)}
    assert {light.on_us for light in controller.lights.values()} == {400.0}
    assert controller.order == ("ring", "low")


def test_the_station_films_with_the_program_of_the_scenario(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path
) -> None:
    scenario = Scenario.model_validate({**small.model_dump(), "program": [{"light": "ring", "on_us": 80.0}]})
    config = site_of(scenario, boards[0], tmp_path)
    assert (config.program, config.controller.order) == (scenario.program, ())
