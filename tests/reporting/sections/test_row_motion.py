"""Deviations from the belt agree with the twin's truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.row_motion import deviation, row_motion


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


def test_every_row_is_a_point_with_its_numbers(stitched: StitchedRun) -> None:
    html = row_motion(stitched).html()
    assert html.count("<circle") == 3 * stitched.head.rows
    assert f"row {stitched.head.rows - 1}: " in html
