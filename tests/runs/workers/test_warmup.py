"""The warm-up stitches a board completely, so that nothing is left to compile."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.model import Status, Stitch
from vaoi_station.runs.workers.warmup import warm_up


@pytest.fixture(scope="module")
def stitch() -> Stitch:
    return warm_up()


def test_every_frame_has_a_matrix(stitch: Stitch) -> None:
    assert [len(row) for row in stitch.image_matrices] == [3, 3]
    assert all(m is not None and np.isfinite(m).all() for row in stitch.image_matrices for m in row)


def test_the_board_is_placed_by_its_fiducials(stitch: Stitch) -> None:
    assert stitch.status is not Status.FAILED
    assert stitch.cad_matrix is not None
    assert stitch.components


def test_the_board_moves_by_one_step_per_row(stitch: Stitch) -> None:
    """The picture was cut with 12 mm between rows, so the estimated motion must be that."""
    steps = [float(d[1, 2]) for d in stitch.row_motion]
    assert np.diff(steps) == pytest.approx([12.0, 12.0], abs=0.05)


def test_it_is_repeatable(stitch: Stitch) -> None:
    again = warm_up()
    assert all(np.array_equal(a, b) for a, b in zip(stitch.row_motion, again.row_motion, strict=True))
