"""The result of a check with its picture, for callers in Python and on the command line."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.check import check_board
from vaoi_station.board_check.picture import picture_of_check
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.model import BoardType


@dataclass(frozen=True, eq=False)
class CheckedBoardType:
    """The result of a check."""

    report: BoardCheck
    """Residuals with standard deviations, components that do not look as if they were there, warnings."""
    picture: NDArray[np.uint8] = field(repr=False)
    """(h, w, 3), BGR: bodies where the run's C puts them (blue), where they are (yellow), and unlikely ones (red)."""

    @property
    def corrected(self) -> BoardType | None:
        """The corrected board type, a draft; None if there is nothing to correct."""
        return self.report.proposal


def checked_board_type(run: CheckedRun, board_type: BoardType) -> CheckedBoardType:
    """Lay a board type over a run."""
    report = check_board(run, board_type)
    return CheckedBoardType(report, picture_of_check(run, board_type, report))
