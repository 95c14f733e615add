"""A station for the twin, as files: station.toml, calibration and board type, made from a scenario."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from vaoi_station.acquisition.ring.ring import RingLayout
from vaoi_station.config import CameraConfig, RingConfig, SimulationConfig, StationConfig
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.files.documents import write_bytes
from vaoi_station.simulation import Twin, read_scenario, scenario_path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  (the ring is made exclusively, mode 0640)
_WITHOUT_TABLES = (str, int, float, bool, list, tuple)


def resolve_scenario(name: str) -> Path:
    """A scenario that comes with the software by its name, or a file.

    Raises:
        NotFoundError: there is neither.
    """
    given = Path(name)
    return given.resolve() if given.suffix or given.exists() else scenario_path(name)


def write_station_files(scenario: Path, folder: Path, *, boards: int = 0) -> tuple[Path, Twin]:
    """Write everything a station needs into an empty folder.

    Args:
        scenario: of the twin.
        folder: where the files and the station's data are to be.
        boards: how many boards pass; 0: they keep coming.

    Returns:
        station.toml, and the twin it is made from.
    """
    twin = Twin(read_scenario(scenario))
    write_calibration(folder / "calibration.json", twin.calibration)
    write_board_type(folder / "board-types" / f"{twin.board_type.name}.json", twin.board_type)
    path = folder / "station.toml"
    write_bytes(path, to_toml(station_config(twin, scenario, folder, boards)).encode())
    return path, twin


def station_config(twin: Twin, scenario: Path, folder: Path, boards: int) -> StationConfig:
    """The configuration of a station that stands at the twin's line."""
    array = twin.scenario.array
    cameras = tuple(
        CameraConfig(
            name=f"camera {n}",
            width=array.width_px,
            height=array.height_px,
            exposure_us=array.exposure_us(n),
            pixel_format="Mono8" if array.bits == 8 else "Mono16",
        )
        for n in range(array.cameras)
    )
    config = StationConfig(
        name=f"demo-{os.getpid()}",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / "data",
        line=twin.line,
        cameras=cameras,
        simulation=SimulationConfig(scenario=scenario, boards=boards, interval_s=twin.scenario.line.interval_s),
    )
    room = ring_directory(RingLayout.of(config).file_bytes, folder)
    return config.model_copy(update={"ring": RingConfig(directory=room)})


def ring_directory(size_bytes: int, folder: Path) -> Path:
    """Shared memory, where there is enough of it; in containers there often is not, and a file has to do."""
    if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free > size_bytes:
        return SHARED_MEMORY
    return folder


def to_toml(config: StationConfig) -> str:
    """A configuration as `station.toml`, without what is the default anyway."""
    return "\n".join(_table((), config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))) + "\n"


def _table(path: tuple[str, ...], content: dict[str, Any]) -> list[str]:
    """Lines of a table: its own keys first, then the tables inside it."""
    inner = {k: v for k, v in content.items() if isinstance(v, dict)}
    many = {k: v for k, v in content.items() if isinstance(v, list) and v and isinstance(v[0], dict)}
    lines = [f"{k} = {_value(v)}" for k, v in content.items() if k not in inner and k not in many]
    for key, table in inner.items():
        lines += ["", f"[{'.'.join((*path, key))}]", *_table((*path, key), table)]
    for key, tables in many.items():
        for table in tables:
            lines += ["", f"[[{'.'.join((*path, key))}]]", *_table((*path, key), table)]
    return lines


def _value(value: Any) -> str:
    """JSON's texts, numbers, truth values and lists are TOML's too."""
    assert isinstance(value, _WITHOUT_TABLES)
    return json.dumps(value, ensure_ascii=False)
