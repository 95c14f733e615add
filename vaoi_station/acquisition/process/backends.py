"""Open the devices of the configured backend, and check the inputs of simulated and replayed ones."""

from __future__ import annotations

from vaoi_station.acquisition.devices import Devices
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError


def open_devices(config: StationConfig) -> Devices:
    """Open cameras and controller of the configured backend.

    Raises:
        InputError: the configuration does not fit the devices, the scenario or the recordings.
        DeviceError: a device cannot be opened.
    """
    if config.controller.backend == "serial":
        return _open_hardware(config)
    if config.controller.backend == "replay":
        # Backends are imported on use: the twin and the Aravis library are slow to load.
        from vaoi_station.acquisition.simulated.replay import open_replay

        return open_replay(config)
    from vaoi_station.acquisition.simulated.twin_devices import open_simulated

    return open_simulated(config)


def _open_hardware(config: StationConfig) -> Devices:
    """Open real cameras and a real controller."""
    from vaoi_station.acquisition.cameras.aravis.opening import open_aravis_cameras
    from vaoi_station.acquisition.controller.serial import open_serial_controller

    # The controller is opened first: it fails at once, while an absent camera is noticed only after seconds.
    controller = open_serial_controller(config)
    try:
        return Devices(open_aravis_cameras(config), controller)
    except BaseException:  # also KeyboardInterrupt: free the port for the next attempt, then raise it again
        controller.close()
        raise


def check_backends(config: StationConfig) -> None:
    """Raise InputError for a scenario or recordings that do not fit the station: a second attempt would fail too."""
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
