"""Residual vectors show the displacement of a camera in size and direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.reporting.sections.residual_vectors import Vectors, residual_vectors, vectors
from vaoi_station.stitching.recordings.opening import open_run


def test_vectors_are_the_links_of_the_adjustment(stitched: StitchedRun) -> None:
    count = stitched.result.quality["links"]
    rows = [vectors(stitched, i, "rows") for i in range(stitched.cameras)]
    assert sum(v.links for v in rows) == count["rows"]["used"]
    assert [len(v.at_px) for v in rows] == [2 * v.links for v in rows], "both ends lie in frames of the camera"
    sides = [vectors(stitched, i, "neighbours") for i in range(2)]
    assert [v.links for v in sides] == [count["neighbours"]["used"]] * 2
    assert sides[0].off_px.mean(0) == pytest.approx(-sides[1].off_px.mean(0), abs=0.01)
    assert "exaggerated" in residual_vectors(stitched).lead


def test_displaced_camera_is_corrected_and_leaves_no_seam(run: Path, tmp_path: Path) -> None:
    known = read_calibration(run / "calibration.json")
    off_mm = 0.12
    moved = known.camera_matrices[1] @ np.array([[1, 0, 0], [0, 1, off_mm], [0, 0, 1]])
    write_calibration(
        tmp_path / "calibration.json", known.model_copy(update={"camera_matrices": (known.camera_matrices[0], moved)})
    )
    stitched = restitch(open_run(run, calibration=tmp_path / "calibration.json"))
    left, right = (np.median(vectors(stitched, i, "neighbours").off_px, axis=0) for i in range(2))
    assert max(np.hypot(*left), np.hypot(*right)) < 0.1
    one, other = (d[1] for d in stitched.result.quality["camera_displacement_px"])
    assert abs(other - one) == pytest.approx(off_mm * 18, rel=0.05), "18 px/mm; pictures do not show which one moved"


def test_means_are_taken_per_cell() -> None:
    camera = Camera(140, 140, Projective(np.eye(3), System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0))
    v = Vectors(np.array([[1.0, 1], [3, 3], [101, 51]]), np.array([[1.0, 0], [0, 1], [5, 5]]))
    m = v.means(camera)
    assert m.at_px.tolist() == [[2, 2], [101, 51]]
    assert m.off_px.tolist() == [[0.5, 0.5], [5, 5]]
    assert Vectors(np.zeros((0, 2)), np.zeros((0, 2))).means(camera).rms_px is None
