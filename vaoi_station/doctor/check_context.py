"""What a check may look at."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vaoi_station.acquisition.ring.ring_layout import RingLayout
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.doctor.machine import Machine


@dataclass(frozen=True)
class RunningProcess:
    """The process that owns the station's memory now: the station, or `vaoi record` or `view` in its place."""

    pid: int | None
    """None: it is another user's, and may not be looked at."""
    snapshot: dict[str, Any] = field(default_factory=dict)
    """Its answer to GET station; empty where it gave none."""
    no_reply_reason: str = ""
    """Why it gave none."""

    @property
    def description(self) -> str:
        """In a sentence."""
        return "a process of another user" if self.pid is None else f"process {self.pid}"

    @property
    def inspect_command(self) -> str:
        """How to find out what it is."""
        return "sudo vaoi doctor …" if self.pid is None else f"ps -fp {self.pid}"


@dataclass(frozen=True)
class CheckContext:
    """A configuration, the machine it is to run on, and whether it does."""

    config: StationConfig
    machine: Machine
    running: RunningProcess | None

    @property
    def layout(self) -> RingLayout:
        """The ring it needs."""
        return RingLayout.of(self.config)

    @cached_property
    def real_cameras(self) -> tuple[CameraConfig, ...]:
        """Those that are no stand-ins."""
        return tuple(camera for camera in self.config.cameras if camera.backend == "aravis")
