"""A check with its picture."""

from __future__ import annotations

from vaoi_station.board_check.checked import checked_board_type
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.model import BoardType


def test_a_check_has_a_picture_and_no_correction_where_nothing_is_wrong(run: CheckedRun, board: BoardType) -> None:
    checked = checked_board_type(run, board)
    assert checked.report.board_type == "drawn"
    assert checked.corrected is None
    assert checked.picture.shape[2] == 3
