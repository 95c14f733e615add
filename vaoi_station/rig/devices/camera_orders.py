"""What is said to a virtual camera over its wire."""

from __future__ import annotations

from dataclasses import dataclass

DARK = -1
"""The picture nobody has lit."""


@dataclass(frozen=True)
class Order:
    """One edge of the trigger line."""

    picture: int
    """Place in the film; DARK: nothing is to be seen."""
    stamp_ns: int = 0
    """Start of the exposure by the camera's clock; 0: now."""
    light: float = 1.0
    """Brightness relative to the film's."""
    lost: float = 0.0
    """Share of the frame's packets that are not sent."""

    def line(self) -> str:
        """As it goes over the wire."""
        return f"fire {self.picture} {self.stamp_ns} {self.light!r} {self.lost!r}"

    @classmethod
    def of(cls, line: str) -> Order:
        """The inverse of `line`."""
        _, picture, stamp, light, lost = line.split()
        return cls(int(picture), int(stamp), float(light), float(lost))
