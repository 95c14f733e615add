"""Which backend opens the devices of a station, and whether what it is told fits."""

from __future__ import annotations

from vaoi_station.acquisition.devices import Devices
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError


def open_devices(config: StationConfig) -> Devices:
    """Cameras and controller of the configured backend; InputError or DeviceError says what is wrong."""
    if config.controller.backend == "serial":
        return _open_hardware(config)
    if config.controller.backend == "replay":
        from vaoi_station.acquisition.simulated.replay import open_replay

        return open_replay(config)
    from vaoi_station.acquisition.simulated.twin_devices import open_simulated

    return open_simulated(config)


def _open_hardware(config: StationConfig) -> Devices:
    """Real cameras and a real controller; it says at once what is wrong, and so comes first."""
    from vaoi_station.acquisition.cameras.aravis import open_aravis_cameras
    from vaoi_station.acquisition.controller.serial import open_serial_controller

    controller = open_serial_controller(config)
    try:
        return Devices(open_aravis_cameras(config), controller)
    except BaseException:  # whatever ended it, give the port back; it is raised again
        controller.close()
        raise


def check_backends(config: StationConfig) -> None:
    """Refuse at once what no attempt to open the devices could mend: a scenario or recordings that do not fit."""
    if config.controller.backend == "serial":
        return
    if config.controller.backend == "replay":
        from vaoi_station.files import open_recording

        assert config.replay is not None
        for directory in config.replay.recordings:
            cameras = len(open_recording(directory).head.cameras)
            if cameras != len(config.cameras):
                raise InputError.field(directory, "cameras", cameras, f"{len(config.cameras)}, as in station.toml")
    else:
        from vaoi_station.acquisition.simulated.twin_devices import check_scenario

        check_scenario(config)
