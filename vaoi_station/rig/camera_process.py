"""The process of one virtual camera: start and stop it, send it triggers and receive its reports."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.rig.device_process import DeviceProcess

DARK = -1
"""Picture number of a black frame, which is in no file."""


@dataclass(frozen=True)
class TriggerCommand:
    """One rising edge of the trigger line, and the frame that the camera delivers for it."""

    picture: int
    """Index of the picture in the selected file of frames; DARK: a black frame."""
    timestamp_ns: int = 0
    """Start of the exposure, ns of CLOCK_MONOTONIC; 0: use the time at which the frame is sent."""
    brightness: float = 1.0
    """Factor on the grey values above the black level."""
    lost_share: float = 0.0
    """Share of the frame's packets that are not sent, 0 to 1."""
    by_width: float | None = None
    """Brightness of a camera that exposes for as long as the trigger is high; None: the same in both modes."""

    def to_line(self) -> str:
        """Format the command as one line, without the line end."""
        # repr keeps all digits of a float, so that from_line returns an equal command.
        return f"fire {self.picture} {self.timestamp_ns} {self.brightness!r} {self.lost_share!r} {self.by_width!r}"

    @classmethod
    def from_line(cls, line: str) -> TriggerCommand:
        """Parse a line that `to_line` has written."""
        _, picture, timestamp, brightness, lost_share, by_width = line.split()
        width = None if by_width == "None" else float(by_width)
        return cls(int(picture), int(timestamp), float(brightness), float(lost_share), width)


ReportHandler = Callable[[str, int, int], None]
"""Function that receives a report: `sent` or `ignored`, the picture number and the frame id (0 means no frame)."""


class CameraProcess(DeviceProcess):
    """The process of one virtual camera."""

    def __init__(
        self,
        address: str,
        serial: str,
        on_report: ReportHandler = lambda _word, _picture, _id: None,
        sensor_px: tuple[int, int] = (640, 480),
        description: Path | None = None,
    ) -> None:
        """Prepare the process; without a file with a description the camera has the rig's own."""
        command = [sys.executable, "-m", "vaoi_station.rig.virtual_camera", address, serial, *map(str, sensor_px)]
        if description is not None:
            command.append(str(description))
        super().__init__(f"the virtual camera at {address}", command)
        self.address, self.serial, self._on_report = address, serial, on_report
        self._frames: Path | None = None

    def start(self) -> None:
        """Start the process without waiting for it. After a kill it uses the same file of frames as before."""
        super().start()
        if self._frames is not None:
            self.select_frames(self._frames)

    def select_frames(self, path: Path) -> None:
        """Select the file of frames from which the camera takes the pictures of the triggers that follow."""
        self._frames = path
        self.write(f"film {path}")

    def trigger(self, command: TriggerCommand, frames: Path | None = None) -> bool:
        """Trigger the camera once, with a file of frames for this trigger only; return False if it does not run."""
        if frames is None:
            return self.write(command.to_line())
        # The three lines are written together, so that a trigger of another thread does not use the file `frames`.
        return self.write(f"film {frames}", command.to_line(), *([f"film {self._frames}"] if self._frames else []))

    def on_report(self, word: str, rest: list[str]) -> bool:
        """Pass on that a frame was sent, or a trigger ignored."""
        if word != "ready":
            self._on_report(word, int(rest[0]), int(rest[1]) if len(rest) > 1 else 0)
        return word == "ready"
