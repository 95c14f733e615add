"""Write the files of a station for the rig: the station.toml of a real line with the rig's addresses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vaoi_station.acquisition.ring.ring import RingLayout
from vaoi_station.config import CameraConfig, ControllerConfig, LightConfig, RingConfig, StationConfig
from vaoi_station.demo.station_files import ring_directory, to_toml
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.files.documents import write_bytes
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.scenarios import lighting_of
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.motion.timetable import line_of


def build_site(
    scenario: Scenario,
    rendered: RenderedBoard,
    folder: Path,
    *,
    name: str,
    addresses: Sequence[str],
    port: Path,
    workers: int,
) -> Path:
    """Write calibration, board type and station.toml into an empty folder, which also takes the station's data."""
    write_calibration(folder / "calibration.json", rendered.calibration)
    write_board_type(folder / "board-types" / f"{rendered.board_type.name}.json", rendered.board_type)
    lighting = lighting_of(scenario)
    config = StationConfig(
        name=name,
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / "data",
        workers=workers,
        line=line_of(scenario),
        cameras=_cameras(scenario, addresses),
        controller=ControllerConfig(
            backend="serial",
            port=str(port),
            lights={
                # LEDs stay on for the longest exposure; cameras with a shorter one see part of it.
                light: LightConfig(channels=channels, on_us=max(lighting.exposures_us))
                for light, channels in lighting.channels.items()
            },
            order=scenario.line.lights,
        ),
    )
    directory = ring_directory(RingLayout.of(config).file_bytes, folder)
    config = config.model_copy(update={"ring": RingConfig(directory=directory)})
    path = folder / "station.toml"
    write_bytes(path, to_toml(config).encode())
    return path


def _cameras(scenario: Scenario, addresses: Sequence[str]) -> tuple[CameraConfig, ...]:
    array = scenario.array
    return tuple(
        CameraConfig(
            name=f"camera {n}",
            backend="aravis",
            address=address,
            width=array.width_px,
            height=array.height_px,
            exposure_us=array.exposure_us(n),
            pixel_format="Mono8" if array.bits == 8 else "Mono16",
            nominal_center_mm=head.nominal_center_mm,
            nominal_px_per_mm=head.nominal_px_per_mm,
        )
        for n, (address, head) in enumerate(zip(addresses, Twin(scenario).heads, strict=True))
    )
