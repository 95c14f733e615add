"""The input of every check: configuration, machine, and the station process that runs now."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vaoi_station.acquisition.ring.ring_layout import RingLayout
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.doctor.machine import Machine


@dataclass(frozen=True)
class RunningProcess:
    """The process that runs on the station's ring now: `vaoi serve` or `vaoi record`."""

    pid: int | None
    """Process id; None if the process belongs to another user and cannot be inspected."""
    snapshot: dict[str, Any] = field(default_factory=dict)
    """The station's reply to GET station; empty if it did not reply."""
    no_reply_reason: str = ""
    """Why there is no reply; empty if there is one."""

    @property
    def description(self) -> str:
        """The name of the process in a finding, for example "process 812"."""
        return "a process of another user" if self.pid is None else f"process {self.pid}"

    @property
    def inspect_command(self) -> str:
        """The shell command with which a reader can identify the process."""
        return "vaoi doctor …, as root" if self.pid is None else f"ps -fp {self.pid}"


@dataclass(frozen=True)
class CheckContext:
    """The input of every check: configuration, machine, and the process that already runs this station, if any."""

    config: StationConfig
    machine: Machine
    running: RunningProcess | None

    @property
    def layout(self) -> RingLayout:
        """The layout of the ring (its sizes in bytes) that this configuration needs."""
        return RingLayout.of(self.config)

    @cached_property
    def real_cameras(self) -> tuple[CameraConfig, ...]:
        """The cameras that are real devices, not simulated or replayed ones."""
        return tuple(camera for camera in self.config.cameras if camera.backend == "aravis")
