"""The expected position and rotation of the board in row 0, from the configuration of the line."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vaoi_station.line_config import Line
from vaoi_station.model import BoardType


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


def turned_by(rotation_deg: int | None) -> Expectation:
    """Return an expectation that states only the rotation of the board on the belt; None means upright as in CAD."""
    # CAD rotations count counter-clockwise, angles in an image clockwise (docs/conventions.md).
    return Expectation(angle_rad=-math.radians(rotation_deg)) if rotation_deg else Expectation()


def expectation_of(line: Line, board_type: BoardType) -> Expectation:
    """Derive the expectation from the line: the leading edge at the first pulse, and the rail or centre line."""
    expected = line.expected_board
    low, high = board_type.extent()
    size = (high - low) * board_type.mm_per_unit
    width, height = (float(v) for v in (size if expected.rotation_deg % 180 == 0 else size[::-1]))
    # The belt is taken to run along the tester axis that is nearer to its velocity.
    along = 0 if abs(line.conveyor_mm_s[0]) > abs(line.conveyor_mm_s[1]) else 1
    length, across = (width, height) if along == 0 else (height, width)
    velocity = line.conveyor_mm_s[along]
    # The barrier detects the leading edge. The board then travels on until the first pulse.
    leading = line.barrier_mm + velocity * line.start_delay_s
    corner: list[float | None] = [None, None]
    corner[along] = leading - length if velocity > 0 else leading
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
