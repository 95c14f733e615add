"""The paper's method as a whole: a result of the same form, never `ok`, with reasons where it fails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Status
from vaoi_station.stitching import paper_method as paper
from vaoi_station.stitching.paper_method import NO_MEASURE, stitch_by_paper


def error_mm(motion: Any, truth: Any, points: NDArray[np.float64]) -> float:
    """Compute the largest deviation of a row's motion, over points of the board."""
    return max(
        float(np.hypot(*(apply(d, points) - apply(t, points)).T).max()) for d, t in zip(motion, truth, strict=True)
    )


def test_the_papers_chain_works_with_larger_errors_than_ours(filmed: Any) -> None:
    chained = paper.chain_rows(filmed.setup.cameras, filmed.head.rows, lambda i, j: filmed.frames[i, j])
    assert not isinstance(chained, Failure)
    assert np.array_equal(chained[0].matrix, np.eye(3))
    points = np.array([[0.0, -10.0], [30.0, 0.0], [15.0, 10.0]])
    theirs = error_mm([d.matrix for d in chained], filmed.truth["row_motion"], points)
    ours = error_mm(filmed.stitch.row_motion, filmed.truth["row_motion"], points)
    print(f"largest error of a row: the paper's chain {theirs:.4f} mm, ours {ours:.4f} mm")
    assert theirs < 0.5
    assert ours < 0.02
    assert theirs > 2 * ours


@pytest.fixture(scope="module")
def by_paper(filmed: Any) -> Any:
    return stitch_by_paper(filmed.setup, filmed.head, filmed.frame)


def test_the_result_is_degraded_since_it_has_no_measure_of_its_error(by_paper: Any) -> None:
    assert (by_paper.method, by_paper.status, by_paper.reasons) == ("paper", Status.DEGRADED, (NO_MEASURE,))
    assert by_paper.quality["timings_ms"]["whole"] > 0


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
