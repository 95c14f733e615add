"""The report: what is ok, and what is said."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from vaoi_station.demo.demo_report import DemoReport, as_text, headline
from vaoi_station.demo.evaluation import Output, ServiceReplies, evaluate
from vaoi_station.simulation import Passage, Twin

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "engineering" / "demo.md"
OUTPUT = Output("out", "out/contact-sheet.png", 48, 123, 0.4, 9.0)
RUN: dict[str, Any] = {
    "id": "r1", "board_type": "small", "verdict": "ok", "reasons": [], "cameras": 2, "rows": 6,
    "counts": {"ok": 12, "incomplete": 0, "missing": 0},
    "belt": {"nominal_mm_s": [0.0, 100.0], "measured_mm_s": [0.3, 100.7], "ratio": 1.007},
    "timings": {
        "filming_s": 0.9, "ready_after_last_frame_ms": 61.05, "links_ms": 182.5, "conclude_ms": 39.2,
        "links": 28, "links_while_filming": 23,
    },
}  # fmt: skip
QUALITY: dict[str, Any] = {
    "links": {"rows": {"found": 504, "used": 399}, "neighbours": {"found": 68, "used": 54}},
    "residual_px": {"median": 0.028, "scatter": 0.022, "sigma0": 1.0},
    "fiducials": [{"name": "FID1", "residual_px": [0.03, 0.04]}, {"name": "FID2", "residual_px": None}],
    "cad_sigma_px": 0.044,
    "timings_ms": {"motion": 9.5, "cad": 24.8, "verdict": 3.0},
}


@pytest.fixture
def passage(twin: Twin) -> Passage:
    return twin.passage(0)


def told(passage: Passage, *, run: dict[str, Any] | None = None, shift_px: float = 0.0) -> DemoReport:
    places = {ref: [(i, j, x + shift_px, y) for i, j, x, y in v] for ref, v in passage.truth()["views"].items()}
    answers = ServiceReplies(RUN | (run or {}), {"quality": QUALITY, "components": places})
    return evaluate("small", answers, passage, OUTPUT)


def test_everything_is_told(passage: Passage) -> None:
    report = told(passage, shift_px=0.05)
    assert report.ok
    assert report.deviation.rms_px == pytest.approx(0.05, abs=1e-4)
    assert report.residuals.fiducials_px == {"FID1": 0.05, "FID2": None}
    assert report.belt.measured_mm_s == pytest.approx(100.7004, abs=1e-4)
    text = as_text(report)
    for word in ("small", "OK", "12 ok", "399 of 504", "1 of 2", "100.700 mm/s", "61 ms", "cad 25", "0.050 px rms"):
        assert word in text, word
    assert any("0.050 px rms" in fact for fact in headline(report))
    assert DemoReport.model_validate_json(report.model_dump_json()) == report


def test_a_result_that_says_ok_and_is_not_near_the_truth_is_not_ok(passage: Passage) -> None:
    report = told(passage, shift_px=1.2)
    assert not report.ok
    assert "further away" in as_text(report)


def test_a_failed_run_is_told_with_its_reasons(passage: Passage) -> None:
    reasons = [{"code": "stitch-failed", "message": "The board lies turned round."}]
    run = {k: v for k, v in RUN.items() if k not in ("belt", "timings")} | {"verdict": "failed", "reasons": reasons}
    report = evaluate("small", ServiceReplies(run, {}), passage, OUTPUT)
    assert not report.ok
    assert (report.deviation.views, report.sigma_px, report.belt.measured_mm_s) == (0, None, None)
    assert "- The board lies turned round." in as_text(report)
    assert "FAILED" in as_text(report)


def keys(model: type[BaseModel], before: str = "") -> list[str]:
    found = []
    for name, field in model.model_fields.items():
        inner = field.annotation
        nested = isinstance(inner, type) and issubclass(inner, BaseModel)
        found += keys(inner, f"{before}{name}.") if nested else [before + name]  # type: ignore[arg-type]
    return found


def test_the_guide_names_every_key() -> None:
    table = GUIDE.read_text(encoding="utf-8").split("### The report")[1]
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    assert [name for cell in cells for name in re.findall(r"`([^`]*)`", cell)] == keys(DemoReport)
