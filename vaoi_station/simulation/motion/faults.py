"""The faults of one passage, for each camera and row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.scenario import Bounce, FaultSection, OnBoard

_Fault = TypeVar("_Fault", bound=OnBoard)


@dataclass(frozen=True)
class PassageFaults:
    """The faults of one board during its passage."""

    section: FaultSection
    board_number: int
    blocked_s: float
    """Time at which the board interrupts the barrier."""

    @property
    def stuck(self) -> int | None:
        """The row at whose pulse the board stops; None if the board does not stop."""
        return min((f.row for f in self._of(self.section.stuck)), default=None)

    @property
    def turned_deg(self) -> int:
        """The additional rotation with which the board was laid on the belt by mistake: 0, 90, 180 or 270."""
        return sum(f.turned_deg for f in self._of(self.section.turned)) % 360

    @property
    def bounces(self) -> list[Bounce]:
        """The bounces of the barrier's signal by time, which counts from the start of the passage."""
        found = [f.model_copy(update={"at_s": self.blocked_s + f.at_s}) for f in self._of(self.section.bounces)]
        return sorted(found, key=lambda b: b.at_s)

    def lost(self, camera: int, row: int) -> bool:
        """Return whether the frame of this camera and row never arrives."""
        lost = self._of(self.section.lost_frames, camera=camera, row=row)
        return bool(lost or self._of(self.section.lost_rows, row=row))

    def delay_s(self, camera: int, row: int) -> float:
        """Return the delay with which a frame arrives; 0 if it is in time."""
        return max((f.delay_s for f in self._of(self.section.late_frames, camera=camera, row=row)), default=0.0)

    def received_share(self, camera: int, row: int) -> float:
        """Return the share of the frame's bytes that arrive, counted from its start; 0 if it never arrives."""
        if self.lost(camera, row) or self.ignored(camera, row):
            return 0.0
        return min((f.share for f in self._of(self.section.incomplete_frames, camera=camera, row=row)), default=1.0)

    def ignored(self, camera: int, row: int) -> bool:
        """Return whether this camera ignores the pulse of this row."""
        return bool(self._of(self.section.ignored_triggers, camera=camera, row=row))

    def extra_delays_s(self, camera: int, row: int) -> tuple[float, ...]:
        """Return the times of additional exposures of this camera, in seconds after the pulse of this row."""
        return tuple(f.after_s for f in self._of(self.section.extra_frames, camera=camera, row=row))

    def metadata_row(self, camera: int, row: int) -> int:
        """Return the row whose frame id and time stamp the frame of this row carries: its own, unless exchanged."""
        for f in self._of(self.section.exchanged_frames, camera=camera):
            if row in (f.row, f.row + 1):
                # This maps f.row to f.row + 1, and f.row + 1 to f.row.
                return 2 * f.row + 1 - row
        return row

    def free_running_interval_s(self, camera: int) -> float | None:
        """Return the frame interval of a camera that runs without trigger; None if the camera obeys the trigger."""
        return next((f.interval_s for f in self._of(self.section.free_running, camera=camera)), None)

    def stamps_late_s(self, camera: int) -> float:
        """Return the time from the start of an exposure to its time stamp for a camera; 0 if it stamps the start."""
        return next((f.by_s for f in self._of(self.section.late_stamps, camera=camera)), 0.0)

    def absent(self, ref: str) -> bool:
        """Return whether the part named `ref` is absent from this board."""
        return bool(self._of(self.section.absent_parts, ref=ref))

    def hanging(self, pinholes: tuple[Pinhole, ...]) -> tuple[Pinhole, ...]:
        """Return the cameras as they are during this passage: those knocked before it are rotated."""
        hanging = list(pinholes)
        for f in self.section.knocked:
            if self.board_number >= f.from_board:
                hanging[f.camera] = hanging[f.camera].rotated(f.about, math.radians(f.angle_deg))
        return tuple(hanging)

    def _of(self, faults: tuple[_Fault, ...], **place: int | str) -> list[_Fault]:
        here = (f for f in faults if f.board is None or f.board == self.board_number)
        return [f for f in here if all(getattr(f, key) == value for key, value in place.items())]
