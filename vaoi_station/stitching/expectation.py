"""What is known of a board before it is filmed: where it is expected, and what a station knew of line and lights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from vaoi_station.errors import InputError
from vaoi_station.line_config import ExpectedBoard, Line
from vaoi_station.model import BoardType, Finite, RecordingHead, Strict
from vaoi_station.model.board_type import Visibility


@dataclass(frozen=True)
class Expectation:
    """Prior knowledge of the board's position and rotation. By default: the board lies upright, at any position.

    `angle_rad` is the rotation of the board in the image, measured from image x towards image y. It is zero if CAD
    "up" points up in the image and CAD x points right (on the bottom side: left).
    """

    angle_rad: float = 0.0
    angle_tolerance_rad: float = math.radians(8.0)
    corner_mm: tuple[float | None, float | None] = (None, None)
    """Lowest x and lowest y of the board in row 0, tester coordinates; None where unknown."""
    tolerance_mm: float = 4.0
    skipped: tuple[str, ...] = ()
    """Positions of the boards of a panel that are not to be tested, as an earlier machine has stated."""


def expected_in(head: RecordingHead) -> Expectation:
    """Return what a recording states: the rotation of the board on the belt, and which boards are not to be tested."""
    # CAD rotations count counter-clockwise, angles in an image clockwise (docs/conventions.md).
    angle_rad = -math.radians(head.rotation_deg) if head.rotation_deg else 0.0
    return Expectation(angle_rad=angle_rad, skipped=head.skip or ())


def expectation_of(line: Line, board_type: BoardType) -> Expectation:
    """Derive the expectation from the line: the leading edge at the first pulse, and the rail or centre line."""
    return expectation_at(leading_edge_mm(line), line.conveyor_mm_s, line.expected_board, board_type)


def leading_edge_mm(line: Line) -> float:
    """Return where the leading edge of a board is at the first pulse: its tester coordinate along the motion."""
    # The barrier detects the leading edge. The board then travels on until the first pulse.
    return line.barrier_mm + line.conveyor_mm_s[_along(line.conveyor_mm_s)] * line.start_delay_s


def expectation_at(
    leading_mm: float, conveyor_mm_s: tuple[float, float], expected: ExpectedBoard, board_type: BoardType
) -> Expectation:
    """Derive the expectation from the place of the leading edge at the first pulse, and what the line states."""
    low, high = board_type.extent()
    size = (high - low) * board_type.mm_per_unit
    width, height = (float(v) for v in (size if expected.rotation_deg % 180 == 0 else size[::-1]))
    along = _along(conveyor_mm_s)
    length, across = (width, height) if along == 0 else (height, width)
    corner: list[float | None] = [None, None]
    corner[along] = leading_mm - length if conveyor_mm_s[along] > 0 else leading_mm
    if expected.rail_mm is not None:
        corner[1 - along] = expected.rail_mm
    elif expected.center_mm is not None:
        corner[1 - along] = expected.center_mm - across / 2
    return Expectation(
        # CAD rotations count counter-clockwise, angles in an image clockwise (docs/conventions.md).
        angle_rad=-math.radians(expected.rotation_deg),
        angle_tolerance_rad=math.radians(expected.rotation_tolerance_deg),
        corner_mm=(corner[0], corner[1]),
        tolerance_mm=expected.tolerance_mm,
    )


def _along(conveyor_mm_s: tuple[float, float]) -> int:
    """Return the tester axis along which the belt is taken to run: the one that is nearer to its velocity."""
    return 0 if abs(conveyor_mm_s[0]) > abs(conveyor_mm_s[1]) else 1


LEAST_FIDUCIALS = 2
"""Number of fiducials that fix position, rotation and scale of a board."""


def refuse_unplaceable(board_type: BoardType, where: str | Path) -> None:
    """Raise `InputError` if a board type, which came from `where`, has too few fiducials to be placed."""
    found = len(board_type.fiducials)
    if found < LEAST_FIDUCIALS:
        raise InputError(
            f"{where}: board type {board_type.name!r} has {found} fiducial{'' if found == 1 else 's'}, but must have "
            f"at least {LEAST_FIDUCIALS}: fewer do not fix position and rotation of the board.",
            action="Enter further round or square marks, bare pads or tooling holes of the board as fiducials, with "
            "position and diameter.",
            code="too-few-fiducials",
        )


class StitchTerms(Strict):
    """What the result of a run depends on besides its recording, calibration, board type, method and reference."""

    leading_edge_mm: Finite
    """Expected place of the board's leading edge at the first pulse: its tester coordinate along the motion."""
    conveyor_mm_s: tuple[Finite, Finite]
    """Nominal velocity of the belt."""
    expected_board: ExpectedBoard
    """Where station.toml and board type expect the board otherwise, and its tolerances."""
    visibility: Visibility
    """How much of every component the frames had to show, unless the board type stated something else."""
    channels: dict[str, tuple[int, ...]]
    """LED channels of every light, which the reason for a dark light names."""

    @classmethod
    def of(cls, line: Line, visibility: Visibility, channels: Mapping[str, tuple[int, ...]]) -> Self:
        """Return the terms of runs of a board type, from the line as the board type needs it."""
        return cls(
            leading_edge_mm=leading_edge_mm(line),
            conveyor_mm_s=line.conveyor_mm_s,
            expected_board=line.expected_board,
            visibility=visibility,
            channels=dict(channels),
        )

    def expectation(self, board_type: BoardType) -> Expectation:
        """Return where and how the board is expected; another board type than that of the run may be longer."""
        return expectation_at(self.leading_edge_mm, self.conveyor_mm_s, self.expected_board, board_type)
