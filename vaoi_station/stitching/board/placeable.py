"""Refusal of board types that no run can place because they have too few fiducials."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.model import BoardType

LEAST_FIDUCIALS = 2
"""Number of fiducials that fix position, rotation and scale of a board."""


def refuse_unplaceable(board_type: BoardType, where: str | Path) -> None:
    """Raise `InputError` if a board type has too few fiducials to be placed.

    Args:
        board_type: the board type.
        where: the file or request from which it came, for the message.
    """
    found = len(board_type.fiducials)
    if found < LEAST_FIDUCIALS:
        raise InputError(
            f"{where}: board type {board_type.name!r} has {found} fiducial{'' if found == 1 else 's'}, but must have "
            f"at least {LEAST_FIDUCIALS}: fewer do not fix position and rotation of the board.",
            action="Enter further round or square marks, bare pads or tooling holes of the board as fiducials, with "
            "position and diameter.",
            code="too-few-fiducials",
        )
