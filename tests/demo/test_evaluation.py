"""Build the demo report from replies and truth."""

from __future__ import annotations

import pytest

from tests.demo.conftest import OUTPUT, RUN, Evaluate
from vaoi_station.demo.demo_report import LIMIT_PX
from vaoi_station.demo.evaluation import ServiceReplies, evaluate, within_limit
from vaoi_station.demo.truth_comparison import Deviation
from vaoi_station.simulation import Passage


def test_figures_come_from_the_replies(evaluated: Evaluate) -> None:
    report = evaluated(shift_px=0.05)
    assert report.ok
    assert report.deviation.rms_px == pytest.approx(0.05, abs=1e-4)
    assert report.residuals.fiducials_px == {"FID1": 0.05, "FID2": None}
    assert report.residuals.links["rows"].used == 399
    assert report.belt.measured_mm_s == pytest.approx(100.7004, abs=1e-4)
    assert report.belt.true_mm_s == pytest.approx(100, abs=3)
    assert (report.timings.links, report.timings.links_while_filming) == (28, 23)
    assert (report.components, report.pictures, report.out) == (48, 123, "out")


def test_ok_verdict_far_from_the_truth_is_not_ok(evaluated: Evaluate) -> None:
    report = evaluated(shift_px=1.2)
    assert report.status == "ok"
    assert not report.ok


def test_failed_run_without_matrices(passage: Passage) -> None:
    reasons = [{"code": "stitch-failed", "message": "The board lies turned by 180 degrees."}]
    run = {k: v for k, v in RUN.items() if k not in ("belt", "timings")} | {"verdict": "failed", "reasons": reasons}
    report = evaluate("small", ServiceReplies(run, {}), passage, OUTPUT)
    assert not report.ok
    assert (report.deviation.views, report.sigma_px, report.belt.measured_mm_s) == (0, None, None)
    assert report.deviation.unplaced > 0
    assert report.timings.ready_after_last_frame_ms is None


@pytest.mark.parametrize(
    ("max_px", "unplaced", "within"), [(LIMIT_PX, 0, True), (LIMIT_PX + 0.01, 0, False), (0.0, 1, False)]
)
def test_limit_and_missing_views(max_px: float, unplaced: int, within: bool) -> None:
    found = Deviation(views=9, unplaced=unplaced, rms_px=0, max_px=max_px, rms_mm=0, max_mm=0, worst=None)
    assert within_limit(found) == within
