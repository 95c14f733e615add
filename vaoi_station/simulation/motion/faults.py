"""The faults of one passage, for each camera and row."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.scenario import FaultSection


@dataclass(frozen=True)
class BarrierBounceTime:
    """A period in which the barrier signal is inverted. It starts `at_s` seconds after the start of the passage."""

    at_s: float
    duration_s: float


@dataclass(frozen=True)
class PassageFaults:
    """The faults of one board during its passage, with functions that return the faults of one camera and row."""

    section: FaultSection
    board_number: int
    blocked_s: float
    stuck: int | None
    """The row at whose pulse the board stops; None if the board does not stop."""

    def lost(self, camera: int, row: int) -> bool:
        """Return whether the frame of this camera and row never arrives."""
        frame = any(
            (f.camera, f.row) == (camera, row) for f in self.section.lost_frames if f.applies_to(self.board_number)
        )
        return frame or any(f.row == row for f in self.section.lost_rows if f.applies_to(self.board_number))

    def delay_s(self, camera: int, row: int) -> float:
        """Return the delay with which the frame of this camera and row arrives; 0 if it is in time."""
        found = (f for f in self.section.late_frames if f.applies_to(self.board_number))
        return max((f.delay_s for f in found if (f.camera, f.row) == (camera, row)), default=0.0)

    def received_share(self, camera: int, row: int) -> float:
        """Return the share of the frame's bytes that arrive, counted from its start.

        It is 1 for a complete frame, and 0 for a frame that never arrives.
        """
        if self.lost(camera, row) or self.ignored(camera, row):
            return 0.0
        found = (f for f in self.section.incomplete_frames if f.applies_to(self.board_number))
        return min((f.share for f in found if (f.camera, f.row) == (camera, row)), default=1.0)

    def ignored(self, camera: int, row: int) -> bool:
        """Return whether this camera ignores the pulse of this row."""
        found = (f for f in self.section.ignored_triggers if f.applies_to(self.board_number))
        return any((f.camera, f.row) == (camera, row) for f in found)

    def extra_delays_s(self, camera: int, row: int) -> tuple[float, ...]:
        """Return the times of additional exposures of this camera, in seconds after the pulse of this row."""
        found = (f for f in self.section.extra_frames if f.applies_to(self.board_number))
        return tuple(f.after_s for f in found if (f.camera, f.row) == (camera, row))

    def metadata_row(self, camera: int, row: int) -> int:
        """Return the row whose frame id and time stamp the frame of this row carries.

        It is this row itself, unless the scenario exchanges the metadata of two frames.
        """
        for f in self.section.exchanged_frames:
            if f.applies_to(self.board_number) and f.camera == camera and row in (f.row, f.row + 1):
                # This maps f.row to f.row + 1, and f.row + 1 to f.row.
                return 2 * f.row + 1 - row
        return row

    def free_running_interval_s(self, camera: int) -> float | None:
        """Return the frame interval of a camera that runs without trigger; None if the camera obeys the trigger."""
        found = (f for f in self.section.free_running if f.applies_to(self.board_number))
        return next((f.interval_s for f in found if f.camera == camera), None)

    def stamps_late_s(self, camera: int) -> float:
        """Return the time from the start of an exposure to its time stamp for a camera; 0 if it stamps the start."""
        found = (f for f in self.section.late_stamps if f.applies_to(self.board_number))
        return next((f.by_s for f in found if f.camera == camera), 0.0)

    @property
    def bounces(self) -> tuple[BarrierBounceTime, ...]:
        """The bounces of the barrier's signal, sorted by time."""
        found = [
            BarrierBounceTime(self.blocked_s + f.at_s, f.duration_s)
            for f in self.section.bounces
            if f.applies_to(self.board_number)
        ]
        return tuple(sorted(found, key=lambda b: b.at_s))

    def absent(self, ref: str) -> bool:
        """Return whether the part named `ref` is absent from this board."""
        return any(f.ref == ref for f in self.section.absent_parts if f.applies_to(self.board_number))


def stuck_row(section: FaultSection, board_number: int) -> int | None:
    """Return the row at whose pulse this board stops; None if the board does not stop."""
    return min((f.row for f in section.stuck if f.applies_to(board_number)), default=None)


def extra_turn_deg(section: FaultSection, board_number: int) -> int:
    """Return the additional rotation with which this board was laid on the belt by mistake: 0, 90, 180 or 270."""
    return sum(f.turned_deg for f in section.turned if f.applies_to(board_number)) % 360


def knocked_pinholes(section: FaultSection, pinholes: tuple[Pinhole, ...], board_number: int) -> tuple[Pinhole, ...]:
    """Return the cameras as they are during this board's passage. Cameras knocked before it are rotated."""
    hanging = list(pinholes)
    for f in section.knocked:
        if board_number >= f.from_board:
            hanging[f.camera] = hanging[f.camera].rotated(f.about, math.radians(f.angle_deg))
    return tuple(hanging)
