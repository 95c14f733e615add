"""Open the devices of the configured backend, and check the inputs of simulated and replayed ones."""

from __future__ import annotations

import contextlib

from vaoi_station.acquisition.devices import Devices
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, VaoiError


def open_devices(config: StationConfig) -> Devices:
    """Open cameras and controller of the configured backend."""
    if config.controller.backend == "serial":
        return _open_hardware(config)
    if config.controller.backend == "replay":
        # Backends are imported on use: the twin and the Aravis library are slow to load.
        from vaoi_station.acquisition.replay import open_replay

        return open_replay(config)
    from vaoi_station.acquisition.simulated import open_simulated

    return open_simulated(config)


def _open_hardware(config: StationConfig) -> Devices:
    from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
    from vaoi_station.acquisition.controller.serial import SerialController

    # The controller is opened first: it fails at once, while an absent camera is noticed only after seconds.
    controller = SerialController(config.controller, contacts=config.smema is not None)
    try:
        return Devices(open_aravis_cameras(config), controller)
    except BaseException:  # also KeyboardInterrupt: free the port for the next attempt, then raise it again
        controller.close()
        raise


def row_lights(config: StationConfig) -> tuple[str, ...]:
    """Return the names of the lights of rows 0, 1, …; after the last name the sequence begins again.

    It is empty if the lights are not known: recordings that are replayed differ, or the scenario cannot be read.
    """
    if config.controller.backend == "serial":
        return config.controller.light_sequence
    # A file that cannot be read is reported by the process that opens the devices.
    with contextlib.suppress(VaoiError):
        if config.replay is not None:
            from vaoi_station.files import open_recording

            lights = {open_recording(directory).head.lights or () for directory in config.replay.recordings}
            return lights.pop() if len(lights) == 1 else ()
        if config.simulation is not None:
            from vaoi_station.simulation import read_scenario

            scenario = read_scenario(config.simulation.scenario)
            return tuple(step.light for step in scenario.program) or scenario.line.lights
    return ()


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
        from vaoi_station.acquisition.simulated import check_scenario

        check_scenario(config)
