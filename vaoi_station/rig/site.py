"""Write the files of a station on the rig: station.toml with the rig's addresses, calibration, board type."""

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
    interlock: bool = False,
) -> Path:
    """Write calibration, board type and station.toml into an empty folder; return the path of station.toml.

    Args:
        scenario: scenario of the twin.
        rendered: a rendered board, which has the calibration and the board type.
        folder: an empty folder; the station also stores its data there.
        name: name of the station.
        addresses: address of each camera.
        port: path of the controller's serial port.
        workers: number of worker processes.
        interlock: whether the conveyor holds boards back while the output "line ready" is off.
    """
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
                # LEDs stay on for the longest exposure; cameras with a shorter exposure use a part of this time.
                light: LightConfig(channels=channels, on_us=max(lighting.exposures_us))
                for light, channels in lighting.channels.items()
            },
            order=() if scenario.program else scenario.line.lights,
            interlock="on" if interlock else "off",
        ),
        program=scenario.program,
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
            width=array.frame_px(n)[0],
            height=array.frame_px(n)[1],
            exposure_us=array.exposure_us(n),
            pixel_format="Mono8" if array.bits == 8 else "Mono16",
            nominal_center_mm=head.nominal_center_mm,
            nominal_px_per_mm=head.nominal_px_per_mm,
            nominal_roll_deg=head.nominal_roll_deg,
        )
        for n, (address, head) in enumerate(zip(addresses, Twin(scenario).heads, strict=True))
    )
