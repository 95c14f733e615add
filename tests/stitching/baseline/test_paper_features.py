"""The paper's chain of rows: features, steps, and its error against the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vaoi_station.stitching.baseline import paper_features as paper

from vaoi_station.geometry import Euclidean, apply
from vaoi_station.geometry.robust import Failure


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


def test_at_most_600_corners(filmed: Any) -> None:
    found = paper.detect_features(filmed.frames[0, 2])
    assert 100 < len(found.px) <= 600
    assert found.descriptors.shape == (len(found.px), 128)


def test_step_of_moved_features_is_the_motion(workshop: Any) -> None:
    g = np.random.default_rng(1)
    camera = workshop.camera()
    at, descriptors = g.uniform(20, 140, (50, 2)), g.uniform(0, 255, (50, 128)).astype(np.float32)
    back = np.array([[np.cos(0.01), -np.sin(0.01), 0.3], [np.sin(0.01), np.cos(0.01), -4.0], [0, 0, 1]])
    later = camera.project(apply(np.linalg.inv(back), camera.ground(at)))
    motion = paper.estimate_step([paper.Features(at, descriptors)], [paper.Features(later, descriptors)], [camera])
    assert isinstance(motion, Euclidean)
    assert motion.matrix == pytest.approx(back, abs=1e-4)


def test_frames_without_features_fail_with_a_reason(workshop: Any) -> None:
    grey = np.full((160, 200), 30, dtype=np.uint8)
    assert len(paper.detect_features(grey).px) == 0
    failed = paper.chain_rows((workshop.camera(),), 3, lambda camera, row: grey)
    assert isinstance(failed, Failure)
    assert failed.reason == "rows 0 and 1: 0 matches between two rows; 6 are needed"


def test_a_camera_without_features_leaves_the_step_to_the_others(workshop: Any) -> None:
    g = np.random.default_rng(2)
    cameras = (workshop.camera((0, 0)), workshop.camera((18, 0)))
    at, descriptors = g.uniform(20, 140, (40, 2)), g.uniform(0, 255, (40, 128)).astype(np.float32)
    blind = paper.Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32))
    later = cameras[1].project(cameras[1].ground(at) + (0.1, 5.0))
    step = paper.estimate_step(
        [blind, paper.Features(at, descriptors)], [blind, paper.Features(later, descriptors)], cameras
    )
    assert isinstance(step, Euclidean)
    assert step.matrix[:2, 2] == pytest.approx((-0.1, -5.0), abs=1e-4)


def test_ambiguous_matches_are_left_out(workshop: Any) -> None:
    """All descriptors are alike, so none is plainly the best."""
    g = np.random.default_rng(3)
    at, alike = g.uniform(20, 140, (50, 2)), np.ones((50, 128), dtype=np.float32)
    failed = paper.estimate_step([paper.Features(at, alike)], [paper.Features(at + 3, alike)], [workshop.camera()])
    assert isinstance(failed, Failure)
    assert failed.reason == "0 matches between two rows; 6 are needed"


def test_a_few_false_matches_do_not_change_the_step(workshop: Any) -> None:
    g = np.random.default_rng(4)
    camera = workshop.camera()
    at, descriptors = g.uniform(20, 140, (60, 2)), g.uniform(0, 255, (60, 128)).astype(np.float32)
    later = camera.project(camera.ground(at) + (0.0, 4.0))
    later[:15] = g.uniform(20, 140, (15, 2))
    step = paper.estimate_step([paper.Features(at, descriptors)], [paper.Features(later, descriptors)], [camera])
    assert isinstance(step, Euclidean)
    assert step.matrix == pytest.approx(np.array([[1, 0, 0], [0, 1, -4.0], [0, 0, 1]]), abs=1e-4)
