"""The equations of one run, on links and fiducials of made-up cameras, exact up to displacements that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.drift.displacement import displace_camera
from vaoi_station.drift.equations import DisplacementEstimate, estimate_displacements
from vaoi_station.drift.evidence import prepare_evidence
from vaoi_station.geometry import Camera, Lens, Projective, System, apply
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import board_plane
from vaoi_station.stitching.matching.evidence import Detections, Evidence, Links, Task

SIZE, PX_PER_MM, ROWS = (480, 360), 14.0, 4
VELOCITY = (0.0, 60.0)
TIMES = np.arange(ROWS, dtype=np.float64) * 0.1
BOARD = BoardType.model_validate(
    {
        "name": "b",
        "y_axis": "down",
        "outline": [[0, 0], [80, 30]],
        "fiducials": [{"name": n, "x": x, "y": y, "diameter": 1.0} for n, x, y in (("A", 5, 5), ("B", 75, 25))],
    }
)
C = np.array([1.0, 0.0, -12.0, -10.0])


def camera(x_mm: float) -> Camera:
    n = np.array([[PX_PER_MM, 0, 239.5 - PX_PER_MM * x_mm], [0, PX_PER_MM, 179.5], [0, 0, 1.0]])
    return Camera(*SIZE, Projective(n, System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0), 300.0)


CAMERAS = tuple(camera(28.0 * i) for i in range(3))
MOTION = Motion(np.array([0.0, 1e-3, -5e-4, 2e-4]), np.array([[0.02 * j, -6.1 * j] for j in range(ROWS)]), np.zeros(2))


def seen(cameras: tuple[Camera, ...], with_marks: bool, sigma_px: float = 0.02) -> list[Evidence]:
    """Evidence of a textured board under cameras as they hang, without noise."""
    g = np.random.default_rng(0)
    board = g.uniform((-14, -30), (70, 14), (900, 2))
    c = board_plane(BOARD, CAMERAS[0]).matrix(C)
    marks = apply(c, np.array([(f.x, f.y) for f in BOARD.fiducials]))
    out: list[Evidence] = []

    def links(task: Task) -> None:
        a, b = task.a, task.b or task.a
        px = [cameras[i].project(MOTION.row_from_tester(j)(board)) for i, j in (a, b)]
        both = cameras[a[0]].sees(px[0], 8) & cameras[b[0]].sees(px[1], 8)
        use = np.flatnonzero(both)[:40]
        information = np.tile(np.eye(2) / sigma_px**2, (len(use), 1, 1))
        out.append(Links(task, px[0][use], px[1][use], information, np.ones(len(use))))

    for j in range(ROWS):
        for i in range(3):
            if j + 1 < ROWS:
                links(Task("rows", (i, j), (i, j + 1), 0.1))
            if i < 2:
                links(Task("neighbours", (i, j), (i + 1, j)))
            px = cameras[i].project(MOTION.row_from_tester(j)(marks))
            px = px[cameras[i].sees(px, 8)] if with_marks else px[:0]
            k = len(px)
            out.append(Detections(Task("marks", (i, j)), px, np.full(k, 0.02), np.ones(k), np.zeros(k, dtype=np.int_)))
    return out


def estimated(displacement_px: np.ndarray, with_marks: bool = True) -> DisplacementEstimate:
    """Estimate under the calibration, when the cameras have moved since."""
    hang = tuple(displace_camera(c, d) for c, d in zip(CAMERAS, displacement_px, strict=True))
    matrix = board_plane(BOARD, CAMERAS[0]).matrix(C) if with_marks else None
    stitch = Stitch(method="auto", image_matrices=(), cad_matrix=matrix, row_motion=(), status=Status.OK)
    run = prepare_evidence(CAMERAS, BOARD, TIMES, VELOCITY, seen(hang, with_marks), stitch)
    return estimate_displacements(run)


def predicted(estimate: DisplacementEstimate, d: np.ndarray) -> float:
    """Compute the largest violation of information · d = vector, in standard deviations of each equation."""
    left = estimate.information @ d.ravel() - estimate.vector
    return float((np.abs(left) / np.sqrt(np.diag(estimate.information))).max())


@pytest.mark.parametrize("with_marks", [True, False])
def test_cameras_as_calibrated_show_no_displacement(with_marks: bool) -> None:
    found = estimated(np.zeros((3, 3)), with_marks)
    assert predicted(found, np.zeros((3, 3))) < 0.05
    assert np.nanmax(found.rms_px) < 0.02
    assert found.links[1] == found.links[0] + found.links[2] > 150, "every link of a seam counts for both cameras"
    assert (found.fiducials.sum() > 0) == with_marks


@pytest.mark.parametrize("moved", [(2.0, 0.0, 0.0), (0.0, -3.0, 0.5), (0.3, 0.2, -0.4)])
def test_the_true_displacement_solves_the_equations(moved: tuple[float, float, float]) -> None:
    d = np.zeros((3, 3))
    d[1] = moved
    found = estimated(d)
    assert predicted(found, d) < 0.3
    assert predicted(found, np.zeros((3, 3))) > 3
    assert found.left_px[1] < 0.1 * found.rms_px[1]


def test_a_shift_of_the_whole_array_is_not_observable() -> None:
    """The common shift across the belt has next to no information; a shift of one camera has much."""
    found = estimated(np.zeros((3, 3)), with_marks=False)
    together, alone = np.zeros((3, 3)), np.zeros((3, 3))
    together[:, 0], alone[1, 0] = 1, 1
    assert together.ravel() @ found.information @ together.ravel() < 1e-3 * (
        alone.ravel() @ found.information @ alone.ravel()
    )


def test_information_is_symmetric_and_not_negative() -> None:
    found = estimated(np.zeros((3, 3)))
    assert np.array_equal(found.information, found.information.T)
    assert np.linalg.eigvalsh(found.information).min() > -1e-6 * np.abs(found.information).max()


def test_a_camera_without_links_has_no_residuals() -> None:
    stitch = Stitch(method="auto", image_matrices=(), cad_matrix=None, row_motion=(), status=Status.OK)
    evidence = [e for e in seen(CAMERAS, False) if not (e.task.kind == "neighbours" and e.task.a[0] == 1)]
    run = prepare_evidence(CAMERAS, BOARD, TIMES, VELOCITY, evidence, stitch)
    found = estimate_displacements(run)
    assert np.isnan(found.rms_px[2])
    assert found.links[2] == 0
    empty = prepare_evidence(CAMERAS, BOARD, TIMES, VELOCITY, [], stitch)
    assert estimate_displacements(replace(empty, motion=MOTION)).links.tolist() == [0, 0, 0]
