"""Which backend opens the devices of a station."""

from __future__ import annotations

from vaoi_station.acquisition.devices import Devices
from vaoi_station.config import StationConfig


def open_devices(config: StationConfig) -> Devices:
    """Cameras and controller of the configured backend; InputError or DeviceError says what is wrong."""
    if config.controller.backend == "replay":
        from vaoi_station.acquisition.replay import open_replay

        return open_replay(config)
    from vaoi_station.acquisition.simulated import open_simulated

    return open_simulated(config)
