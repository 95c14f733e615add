"""The paper's method as a whole: a result of the same form, never `ok`, with reasons where it fails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import Euclidean, System
from vaoi_station.model import Status
from vaoi_station.stitching.paper_method import NO_MEASURE, as_motion, stitch_by_paper


@pytest.fixture(scope="module")
def by_paper(filmed: Any) -> Any:
    return stitch_by_paper(filmed.setup, filmed.head, filmed.frame)


def test_the_result_is_degraded_since_it_has_no_measure_of_its_error(by_paper: Any) -> None:
    assert (by_paper.method, by_paper.status, by_paper.reasons) == ("paper", Status.DEGRADED, (NO_MEASURE,))
    assert by_paper.quality["timings_ms"]["whole"] > 0


def test_matrices_are_products_of_camera_and_row(by_paper: Any, filmed: Any) -> None:
    for i, rows in enumerate(by_paper.image_matrices):
        for j, m in enumerate(rows):
            np.testing.assert_allclose(m, filmed.calibration.camera_matrices[i] @ by_paper.row_motion[j], rtol=1e-9)


def test_the_cad_matrix_is_near_the_truth(by_paper: Any, filmed: Any) -> None:
    low, high = filmed.board_type.extent()
    corners = np.array([(*low, 1.0), (*high, 1.0)])
    off = corners @ (by_paper.cad_matrix - np.array(filmed.truth["cad_matrix"])).T
    assert np.abs(off[:, :2]).max() < 0.5


def test_without_a_board_type_it_fails_but_places_the_frames(filmed: Any) -> None:
    result = stitch_by_paper(replace(filmed.setup, board_type=None), filmed.head, filmed.frame)
    assert (result.status, result.cad_matrix) == (Status.FAILED, None)
    assert result.reasons == ("no board type was given, so there is no CAD mapping",)
    assert all(m is not None for rows in result.image_matrices for m in rows)


def test_a_blank_row_breaks_the_chain(filmed: Any) -> None:
    """No frame of row 2: no transform leads across it."""
    result = stitch_by_paper(filmed.setup, filmed.head, lambda i, j: None if j == 2 else filmed.frame(i, j))
    assert result.status is Status.FAILED
    assert result.reasons[0].startswith("the chain of rows is broken: rows 1 and 2: 0 matches")
    assert all(m is None for rows in result.image_matrices for m in rows)
    assert all(np.array_equal(d, np.eye(3)) for d in result.row_motion)


def test_motion_has_the_rows_it_was_made_from(workshop: Any) -> None:
    rows = [Euclidean.motion(0.01 * j, (0.2 * j, 5.0 * j), System.ROW, System.TESTER) for j in range(3)]
    motion = as_motion(rows, (workshop.camera((0, 0)), workshop.camera((12, 3))))
    assert motion.pivot == pytest.approx((6.0, 1.5))
    np.testing.assert_allclose(motion.rows_from_tester, [d.matrix for d in rows], atol=1e-12)
