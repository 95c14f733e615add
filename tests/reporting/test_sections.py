"""The sections of the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.model import BoardType
from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.reporting.figures import (
    data_block,
    deviation,
    fiducials,
    key_numbers,
)
from vaoi_station.reporting.maps import (
    BoardDrawing,
    vectors,
)
from vaoi_station.stitching.recordings.opening import open_run


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_cad_up_is_drawn_upwards(y_axis: str) -> None:
    plan = BoardDrawing(BoardType.model_validate({"name": "b", "outline": [[0, 0], [40, 20]], "y_axis": y_axis}))
    at = plan.at(np.array([[0.0, 0.0], [40.0, 20.0]]))
    assert at[0, 0] < at[1, 0]
    assert (at[0, 1] > at[1, 1]) == (y_axis == "up")
    assert (at >= 0).all()
    assert (at <= (plan.width, plan.height)).all()


def test_displaced_camera_is_corrected_and_leaves_no_seam(run: Path, tmp_path: Path) -> None:
    known = read_calibration(run / "calibration.json")
    off_mm = 0.12
    moved = known.camera_matrices[1] @ np.array([[1, 0, 0], [0, 1, off_mm], [0, 0, 1]])
    write_calibration(
        tmp_path / "calibration.json", known.model_copy(update={"camera_matrices": (known.camera_matrices[0], moved)})
    )
    stitched = restitch(open_run(run, calibration=tmp_path / "calibration.json"))
    left, right = (np.median(vectors(stitched, i, "neighbours")[1], axis=0) for i in range(2))
    assert max(np.hypot(*left), np.hypot(*right)) < 0.1
    one, other = (d[1] for d in stitched.result.quality["camera_displacement_px"])
    assert abs(other - one) == pytest.approx(off_mm * 18, rel=0.05), "18 px/mm; pictures do not show which one moved"


def test_key_numbers_are_those_of_the_result(stitched: StitchedRun) -> None:
    html, q = key_numbers(stitched).html(), stitched.result.quality
    assert f"<dd>{q['residual_px']['median']:.3f} px</dd>" in html
    assert f"{q['links']['rows']['used']} used of {q['links']['rows']['found']}" in html
    present = len(stitched.opened.present)
    assert f"{present} of {present} delivered, {present} placed" in html


def test_deviations_agree_with_the_truth_within_their_uncertainty(stitched: StitchedRun, run: Path) -> None:
    true = [np.array(m) for m in json.loads((run / "truth.json").read_text())["row_motion"]]
    d = deviation(stitched.findings)
    times_s, pivot = stitched.head.row_times_s(), stitched.findings.adjusted.motion.pivot
    along = d.velocity_mm_s / np.hypot(*d.velocity_mm_s)
    across = np.array([-along[1], along[0]])
    for j, (m, held) in enumerate(zip(true, d.held, strict=True)):
        back = np.linalg.inv(m) @ (*pivot, 1.0)
        off = -(back[:2] - pivot) - d.velocity_mm_s * (times_s[j] - times_s[0])
        yaw_mrad = 1e3 * np.arctan2(m[1, 0], m[0, 0])
        expected = np.array([off @ along * 1e3, off @ across * 1e3, yaw_mrad])
        allowed = 4 * d.sigma[j] + (4.0, 4.0, 0.05)
        assert not held or (np.abs(d.value[j] - expected) <= allowed).all(), j
    assert d.value[0].tolist() == [0, 0, 0]
    assert d.sigma[0].tolist() == [0, 0, 0]
    assert (d.sigma[1:] > 0).all()


def with_quality(stitched: StitchedRun, **quality: Any) -> StitchedRun:
    """Return the run with other quality figures."""
    result = stitched.result.model_copy(update={"quality": stitched.result.quality | quality})
    return replace(stitched, result=result)


def test_fiducial_that_was_not_found_has_no_residual(stitched: StitchedRun) -> None:
    absent = [{"name": "FID9", "sightings": 0, "residual_px": None}]
    html = fiducials(with_quality(stitched, fiducials=absent)).html()
    assert html.count('<td class="n">–</td>') == 3


def test_texts_cannot_end_the_script_element(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"reasons": ("</script><script>alert(1)</script>",)})
    block = data_block(replace(stitched, result=result))
    assert block.count("</script>") == 1
    assert "alert(1)" in block
