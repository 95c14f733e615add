"""The search of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.board_check.pose_search import BodyEdges, edge_strengths, find_poses, refine_pose
from vaoi_station.model import BoardType


def test_the_true_pose_leads_all_quarter_turns_and_mirrors(run: CheckedRun, board: BoardType) -> None:
    c = np.array(run.stitch.cad_matrix)
    edges = BodyEdges.of(board)
    poses = find_poses(run.overview, edges, [math.atan2(c[1, 0], c[0, 0])])
    assert len(poses) == 8
    assert len({(p.mirrored, round(math.degrees(p.angle_rad)) % 360) for p in poses}) == 8
    best = poses[0]
    assert best.score > 10 > 1.5 * poses[1].score
    refined, covariance = refine_pose(run.overview, edges, best)
    error = (refined.matrix - c)[:2] @ (*edges.points.mean(0), 1.0)
    sigma = np.sqrt(np.diag(covariance))
    assert np.abs(error) == pytest.approx(0, abs=3 * sigma.max())
    assert 0.01 < sigma.max() < 0.15


def test_a_board_of_a_thousand_components_is_sampled(run: CheckedRun, board: BoardType) -> None:
    """OpenCV refuses a map of more than 32766 lines."""
    c, edges = np.array(run.stitch.cad_matrix), BodyEdges.of(board)
    strength = run.overview.edges(0.3)
    few = edge_strengths(run.overview, strength, edges, c)
    times = 33_000 // len(few) + 1
    arrays = (np.concatenate([a] * times) for a in (edges.points, edges.normals, edges.part, edges.weight))
    many = edge_strengths(run.overview, strength, BodyEdges(*arrays), c)
    assert few.max() > 0
    np.testing.assert_array_equal(many, np.tile(few, times))
