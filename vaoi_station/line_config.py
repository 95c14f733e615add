"""The tables of `station.toml` on the line: geometry, speed and timing, and where boards are expected."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.model import Finite, Positive

NotNegative = Annotated[Finite, Field(ge=0)]


class Section(BaseModel):
    """Base class of the tables in the file: immutable; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ExpectedBoard(Section):
    """Position of the board when the first row is filmed, with tolerances.

    The leading edge follows from barrier, delay and speed. Across the line, a fixed rail or the middle of the
    conveyor guides the board.
    """

    rail_mm: Finite | None = None
    """Tester coordinate, across the motion, of the board's lower edge at the fixed rail."""
    center_mm: Finite | None = None
    """Tester coordinate of the board's middle, on lines that centre boards."""
    rotation_deg: Literal[0, 90, 180, 270] = 0
    """Rotation of the board on the belt, counter-clockwise from CAD-upright as the camera sees it."""
    tolerance_mm: Positive = 4.0
    rotation_tolerance_deg: Annotated[Positive, Field(le=30)] = 3.0

    @model_validator(mode="after")
    def _one_guide(self) -> Self:
        if self.rail_mm is not None and self.center_mm is not None:
            raise ValueError("rail_mm and center_mm exclude each other; give the one that guides the board")
        return self


class Line(Section):
    """The geometry and the timing of the line: speed, barrier, distances."""

    conveyor_mm_s: tuple[Finite, Finite]
    """Nominal velocity of the board in tester coordinates."""
    barrier_mm: Finite
    """Tester coordinate, along the motion, of the light barrier."""
    start_delay_s: NotNegative
    """Time from the interruption of the barrier to the first pulse."""
    trigger_period_s: Positive
    tail_s: NotNegative
    """Time for which pulses continue after the board has left the barrier."""
    longest_board_mm: Positive
    carrier_mm: Positive | None = None
    """Length along the motion of the carrier in which boards ride; None if the barrier sees the boards themselves."""
    debounce_s: NotNegative = 0.005
    """Shorter interruptions of the barrier are ignored as bounces."""
    max_blur_px: Positive = 3.0
    """Longest motion of a picture, px, while a row of a light program is lit."""
    speed_limits_mm_s: tuple[Positive, Positive] | None = None
    """Slowest and fastest speed of the belt that a board type may state; None: only that of `conveyor_mm_s`."""
    rail_limits_mm: tuple[Finite, Finite] | None = None
    """Lowest and highest place of the rail that a board type may state; None: only that of `expected_board`."""
    expected_board: ExpectedBoard = ExpectedBoard()

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.speed_mm_s == 0:
            raise ValueError("conveyor_mm_s is [0, 0], but must not be zero")
        for key in ("speed_limits_mm_s", "rail_limits_mm"):
            limits = getattr(self, key)
            if limits is not None and limits[0] > limits[1]:
                raise ValueError(f"{key} is {list(limits)}, but must begin with the lower limit")
        # The controller would end such a run before its first pulse.
        if self.start_delay_s > self.passing_s:
            raise ValueError(
                f"start_delay_s is {self.start_delay_s}, but the longest board has passed the barrier and "
                f"the tail is over after {self.passing_s:.3f} s"
            )
        return self

    @property
    def speed_mm_s(self) -> float:
        """The speed of the belt (the paper's v)."""
        return math.hypot(*self.conveyor_mm_s)

    @property
    def passing_s(self) -> float:
        """The time from the moment the longest board interrupts the barrier to the end of the tail time, in s."""
        return self.longest_board_mm / self.speed_mm_s + self.tail_s

    @property
    def rows_of_longest_board(self) -> int:
        """Number of pulses for the longest board, from start delay to end of tail (the paper's m)."""
        return 1 + math.ceil((self.passing_s - self.start_delay_s) / self.trigger_period_s)
