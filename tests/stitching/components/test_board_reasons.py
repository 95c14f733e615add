"""Reasons for boards of a panel that their fiducials do not place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vaoi_station.model import ReasonCode
from vaoi_station.stitching.components.bad_boards import board_reasons
from vaoi_station.stitching.components.places import BoardPlace

GOOD = BoardPlace(("F1", "F2"), (), np.zeros(2), 0.0, 0.001, 1e-5, np.zeros(2), 0.002, np.eye(3))
LOST = replace(GOOD, fiducials=(), lost=("F1", "F2"), matrix=None, sigma_mm=0.15, refusal="F1, F2 was not found")


def test_boards_that_are_placed_give_no_reason() -> None:
    assert not list(board_reasons({"1": GOOD, "2": GOOD}, 20.0))


def test_boards_that_follow_the_panel_are_named_with_their_standard_deviation() -> None:
    ((code, text),) = board_reasons({"1": GOOD} | {str(n): LOST for n in range(2, 8)}, 20.0)
    assert code is ReasonCode.BOARD_UNPLACED
    assert text.startswith("6 of 7 boards of the panel follow the panel, with ± 0.15 mm")
    assert "2: F1, F2 was not found" in text
    assert "and 2 more" in text


def test_one_fiducial_alone_is_a_doubt() -> None:
    ((code, text),) = board_reasons({"1": replace(GOOD, fiducials=("F1",), lost=("F2",)), "2": GOOD}, 20.0)
    assert code is ReasonCode.BOARD_UNPLACED
    assert "one fiducial alone places 1 of 2 boards" in text


def test_fiducials_that_disagree_are_named_in_pixels() -> None:
    ((code, text),) = board_reasons({"3": replace(GOOD, off_mm=0.02)}, 20.0)
    assert code is ReasonCode.FIDUCIAL_OFF_PLACE
    assert "fiducials F1, F2 of board 3 of the panel lie up to 0.40 px" in text


def test_a_method_without_fiducials_is_named_as_the_cause() -> None:
    ((code, text),) = board_reasons({"1": LOST, "2": LOST}, 20.0, searched=False)
    assert code is ReasonCode.BOARD_UNPLACED
    assert text.endswith("uses no fiducials: stitch it with the method auto, features or fiducials")
