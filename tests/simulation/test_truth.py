from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.needs import FILMS, need_films
from vaoi_station.simulation import Twin
from vaoi_station.simulation.recording_writer import write_passage

Make = Callable[..., Twin]


def test_one_rigid_motion_per_row_moves_all_cameras(small: Twin) -> None:
    truth = small.passage(2).truth()
    for i, planes in enumerate(truth["image_matrices"]):
        n = small.calibration.camera_matrices[i]
        assert np.allclose(planes[0], n)
        for j, m in enumerate(planes):
            d = np.array(truth["row_motion"][j])
            assert np.allclose(m, n @ d)
            assert np.allclose(d[:2, :2] @ d[:2, :2].T, np.eye(2), atol=1e-12)
            assert np.linalg.det(d) == pytest.approx(1)


@pytest.mark.cases
def test_the_scorer_of_the_cases_accepts_a_recording(small: Twin, tmp_path: Path) -> None:
    need_films()
    case = tmp_path / "case"
    write_passage(small.passage(0), case)
    truth = json.loads((case / "truth.json").read_text())
    result = {k: truth[k] for k in ("image_matrices", "cad_matrix", "row_motion")} | {"status": "ok"}
    (tmp_path / "result.json").write_text(json.dumps(result))
    done = subprocess.run(
        [sys.executable, str(FILMS / "score.py"), str(case), str(tmp_path / "result.json")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    score = json.loads(done.stdout)
    assert score["cad_px"]["max"] < 1e-3
    assert score["rigid"] < 1e-6
    assert score["views"] > 50


def test_a_lifted_board_moves_its_views_but_not_the_matrices(make: Make) -> None:
    flat, lifted = (make(board={"density": 2.0, "lift_mm": lift}).passage(0).truth() for lift in (0.0, 2.0))
    assert flat["image_matrices"] == lifted["image_matrices"]
    common = {(ref, i, j): (u, v) for ref, seen in flat["views"].items() for i, j, u, v in seen}
    moved = [
        np.hypot(common[ref, i, j][0] - u, common[ref, i, j][1] - v)
        for ref, seen in lifted["views"].items()
        for i, j, u, v in seen
        if (ref, i, j) in common
    ]
    assert max(moved) > 0.3
