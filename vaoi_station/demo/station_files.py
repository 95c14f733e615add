"""Write the files of a station on the twin: station.toml, calibration and board type, all from a scenario."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import tomlkit

from vaoi_station.acquisition.ring import RingLayout
from vaoi_station.config import CameraConfig, RingConfig, SimulationConfig, StationConfig
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.files.documents import write_bytes
from vaoi_station.simulation import Twin, read_scenario

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  (the ring is made exclusively, mode 0640)


def write_station_files(scenario: Path, folder: Path, *, boards: int = 0) -> tuple[Path, Twin]:
    """Write all files of a station into an empty folder.

    Args:
        scenario: file of the twin's scenario.
        folder: directory for the files and the station's data.
        boards: number of boards that pass; 0 for no end.

    Returns:
        The path of station.toml, and the twin.
    """
    twin = Twin(read_scenario(scenario))
    write_calibration(folder / "calibration.json", twin.calibration)
    write_board_type(folder / "board-types" / f"{twin.board_type.name}.json", twin.board_type)
    path = folder / "station.toml"
    write_bytes(path, to_toml(station_config(twin, scenario, folder, boards)).encode())
    return path, twin


def station_config(twin: Twin, scenario: Path, folder: Path, boards: int) -> StationConfig:
    """Return the configuration of a station whose line is simulated by the twin."""
    array = twin.scenario.array
    cameras = tuple(
        CameraConfig(
            name=f"camera {n}",
            width=array.frame_px(n)[0],
            height=array.frame_px(n)[1],
            exposure_us=array.exposure_us(n),
            pixel_format="Mono8" if array.bits == 8 else "Mono16",
            nominal_center_mm=twin.heads[n].nominal_center_mm,
            nominal_px_per_mm=twin.heads[n].nominal_px_per_mm,
            nominal_roll_deg=twin.heads[n].nominal_roll_deg,
        )
        for n in range(array.cameras)
    )
    # The process id keeps the rings of two demos on one machine apart: the ring's file is named after the station.
    config = StationConfig(
        name=f"demo-{os.getpid()}",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / "data",
        line=twin.line,
        cameras=cameras,
        simulation=SimulationConfig(scenario=scenario, boards=boards, interval_s=twin.scenario.line.interval_s),
    )
    directory = ring_directory(RingLayout.of(config).file_bytes, folder)
    return config.model_copy(update={"ring": RingConfig(directory=directory)})


def ring_directory(size_bytes: int, folder: Path) -> Path:
    """Return /dev/shm if it has enough space, else `folder`: containers often have a small /dev/shm."""
    if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free > size_bytes:
        return SHARED_MEMORY
    return folder


def to_toml(config: StationConfig) -> str:
    """Format a configuration as the text of `station.toml`. Values equal to their default are left out."""
    return tomlkit.dumps(config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
