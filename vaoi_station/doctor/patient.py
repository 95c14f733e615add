"""What a check may look at."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vaoi_station.acquisition.ring_layout import RingLayout
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.doctor.machine import Machine


@dataclass(frozen=True)
class Running:
    """The process that owns the station's memory now: the station, or `vaoi record` or `view` in its place."""

    pid: int
    snapshot: dict[str, Any] = field(default_factory=dict)
    """Its answer to GET station; empty where it gave none."""
    silence: str = ""
    """Why it gave none."""


@dataclass(frozen=True)
class Patient:
    """A configuration, the machine it is to run on, and whether it does."""

    config: StationConfig
    machine: Machine
    running: Running | None

    @property
    def layout(self) -> RingLayout:
        """The ring it needs."""
        return RingLayout.of(self.config)

    @cached_property
    def real_cameras(self) -> tuple[CameraConfig, ...]:
        """Those that are no stand-ins."""
        return tuple(camera for camera in self.config.cameras if camera.backend == "aravis")
