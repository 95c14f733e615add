"""A reference run: its links become points known in CAD, and its C a first guess."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.reference import Reference, cad_points, initial_similarity, inliers
from vaoi_station.stitching.matching.evidence import Links, Task

PLANE = BoardPlane(BoardType.model_validate({"name": "b", "outline": [[0, 0], [30, 20]]}), mirrored=True)
C = np.array([1.0, 0.02, -12.0, 8.0])
D = (np.eye(3), np.array([[1.0, 0, 0.1], [0, 1, 6.0], [0, 0, 1]]))


def reference(c: np.ndarray | None = None) -> Reference:
    stitch = Stitch(
        method="auto", image_matrices=(), cad_matrix=PLANE.matrix(C if c is None else c), row_motion=D, status=Status.OK
    )
    return Reference(stitch, frozenset({(0, 0), (0, 1)}))


def links(task: Task, a_px: np.ndarray, b_px: np.ndarray, sigma_px: float = 0.02) -> Links:
    k = len(a_px)
    return Links(task, a_px, b_px, np.tile(np.eye(2) / sigma_px**2, (k, 1, 1)), np.ones(k))


def test_linked_points_have_the_cad_places_of_the_reference(workshop: Any) -> None:
    """The run's board lies 0.3 mm further: pixels differ, CAD places do not."""
    camera, g = workshop.camera(), np.random.default_rng(0)
    cad = g.uniform((5, 3), (18, 12), (20, 2))
    board = apply(PLANE.matrix(C), cad)
    found = []
    for row in (0, 1):
        there = apply(D[row], board)
        a_px, b_px = camera.project(there + (0.3, 0.0)), camera.project(there)
        found.append(links(Task("reference", (0, row), (0, row)), a_px, b_px))
    points = cad_points(found, (camera,), PLANE, reference())
    assert points.row.tolist() == [0] * 20 + [1] * 20
    assert set(points.which.tolist()) == {REFERENCE}
    np.testing.assert_allclose(points.cad, np.tile(PLANE.flat(cad), (2, 1)), atol=1e-9)
    np.testing.assert_allclose(points.ground_mm[:20], board + (0.3, 0.0), atol=1e-9)
    assert points.px_per_mm == pytest.approx(10.0)


def test_the_reference_keeps_the_cameras_of_its_own_run(workshop: Any) -> None:
    """A camera that was pushed since, with its old calibration: the reference's points lie where they lay."""
    camera = workshop.camera()
    then = np.array([[1.0, 0, 3.0], [0, 1, -2.0], [0, 0, 1]]) @ camera.image_from_row.matrix
    earlier = reference()
    earlier = replace(earlier, stitch=earlier.stitch.model_copy(update={"camera_matrices": (then,)}))
    cad = np.array([[5.0, 3.0], [18.0, 12.0]])
    ground = apply(PLANE.matrix(C), cad)
    seen = links(Task("reference", (0, 0), (0, 0)), camera.project(ground), camera.project(ground) + (3.0, -2.0))
    points = cad_points([seen], (camera,), PLANE, earlier)
    np.testing.assert_allclose(points.cad, PLANE.flat(cad), atol=1e-9)


def test_many_links_on_one_part_know_its_place_no_better_than_it_is_placed(workshop: Any) -> None:
    """Parts lie elsewhere on every board: 200 links on one would outweigh all fiducials."""
    part = {"ref": "U1", "center": [10.0, 8.0], "width": 6.0, "height": 4.0, "rotation": 0.0}
    plane = BoardPlane(BoardType.model_validate(PLANE.board_type.model_dump() | {"components": [part]}), mirrored=True)
    camera, g = workshop.camera(), np.random.default_rng(0)
    cad = np.concatenate([g.uniform((8, 7), (12, 9), (200, 2)), g.uniform((14, 3), (18, 12), (5, 2))])
    found = []
    for row in (0, 1):
        px = camera.project(apply(D[row], apply(plane.matrix(C), cad)))
        found.append(links(Task("reference", (0, row), (0, row)), px, px))
    points = cad_points(found, (camera,), plane, reference())
    on = (np.arange(410) % 205) < 200
    assert 0.04 < 1 / np.sqrt((points.sigma_mm[on] ** -2.0).sum()) < 0.041
    assert points.sigma_mm[~on].max() < 0.02
    # one of these points is an outlier as any other: no part lies half a millimetre from its place
    off = np.where(on, 5.0, 0.1)[:, None] * (1, 0)
    np.testing.assert_array_equal(inliers(points, off), ~on)


def test_the_first_c_is_that_of_the_reference_shifted_to_the_run() -> None:
    """A fifth of the links is false; the median ignores them."""
    g = np.random.default_rng(2)
    cad = g.uniform(0, 20, (50, 2))
    motion: Motion = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))
    board = apply(PLANE.matrix(C), cad) + (0.8, -1.5)
    board[::5] += g.uniform(5, 9, (10, 2))
    none = np.zeros((50, 2))
    row, one = np.zeros(50, dtype=np.int_), np.ones(50)
    points = FiducialPoints(row, board, none, PLANE.flat(cad), one, one, np.full(50, REFERENCE), row)
    assert initial_similarity(PLANE, reference(), points, motion) == pytest.approx(C + (0, 0, 0.8, -1.5), abs=1e-9)
