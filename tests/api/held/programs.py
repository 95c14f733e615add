"""Checks of light programs for a held station: three real cameras, two lights, and what their devices state."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path
from typing import Any

from vaoi_station.acquisition.cameras.interface import CameraHealth, CameraLimits
from vaoi_station.acquisition.controller.interface import ControllerLimits, FirmwareLimits
from vaoi_station.acquisition.process.messages import Health
from vaoi_station.config import StationConfig
from vaoi_station.runs.lighting.programs import LightPrograms

FIRMWARE = FirmwareLimits("1.3.0", 16, 4, 50.0, (1000.0, 1000.0, 500.0, 500.0), 16, 10_000.0)
LIMITS = CameraLimits((20.0, 30_000.0), (0.0, 24.0))
CONFIG = """# A station for tests.
name = "test"
calibration = "calibration.json"
board_types = "types"
data = "data"

[line]
conveyor_mm_s = [0.0, 100.0]    # along the motion
barrier_mm = -40.0
start_delay_s = 0.32
trigger_period_s = 0.105
tail_s = 0.48
longest_board_mm = 80.0

[line.expected_board]
center_mm = 33.1
rotation_deg = 0
tolerance_mm = 4.0
rotation_tolerance_deg = 3.0

[simulation]
scenario = "scenario.toml"
"""


def station_config(cameras: int, /, **changes: Any) -> StationConfig:
    """Return a station with real cameras and the lights "even" and "left"."""
    camera = {"backend": "aravis", "width": 320, "height": 240, "exposure_us": 250.0, "nominal_px_per_mm": 8.0}
    content: dict[str, Any] = {
        "name": "test",
        "calibration": Path("calibration.json"),
        "board_types": Path("types"),
        "data": Path("data"),
        "line": tomllib.loads(CONFIG)["line"],
        "cameras": [{**camera, "name": f"cam{n}", "serial": str(n)} for n in range(cameras)],
        "controller": {
            "backend": "serial",
            "lights": {"even": {"channels": [0, 1], "on_us": 200.0}, "left": {"channels": [2], "on_us": 120.0}},
        },
    }
    return StationConfig.model_validate({**content, **changes})


def healthy(cameras: int) -> Health:
    """Return the report of devices that have stated their limits."""
    camera = CameraHealth(True, limits=LIMITS)
    return Health((camera,) * cameras, "ok", time.monotonic(), limits=ControllerLimits(firmware=FIRMWARE))


def held_programs(cameras: int, px_per_mm: float) -> LightPrograms:
    """Return the checks of a station whose devices all have reported."""
    return LightPrograms(station_config(cameras), (px_per_mm,) * cameras, lambda: healthy(cameras))
