"""The search of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.board_check.body_edges import BodyEdges
from vaoi_station.board_check.pose_search import find_poses, refine_pose
from vaoi_station.board_check.run_frames import CheckedRun
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
