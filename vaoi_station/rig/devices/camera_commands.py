"""Commands for a virtual camera, as lines of text on its standard input."""

from __future__ import annotations

from dataclasses import dataclass

DARK = -1
"""Picture number of a black frame, which is in no file."""


@dataclass(frozen=True)
class TriggerCommand:
    """One rising edge of the trigger line, and the frame that the camera delivers for it."""

    picture: int
    """Index of the picture in the selected file of frames; DARK: a black frame."""
    timestamp_ns: int = 0
    """Start of the exposure, ns in the camera's clock; 0: use the time at which the frame is sent."""
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
