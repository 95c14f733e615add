"""The demo's report: the run as the service states it, compared with the truth, as text and as JSON."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.demo.report import (
    LIMIT_PX,
    DemoReport,
    Deviation,
    as_text,
    compare_with_truth,
    evaluate,
    headline,
)
from vaoi_station.simulation import Passage, Twin, read_scenario, scenario_path

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "tutorials" / "demo.md"
RUN: dict[str, Any] = {
    "id": "r1", "board_type": "small", "verdict": "ok", "reasons": [], "cameras": 2, "rows": 6, "frames": [1, 2],
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
OUTPUT = {
    "components": 48, "pictures": 123, "pictures_s": 0.4, "total_s": 9.0, "out": "out",
    "contact_sheet": "out/contact-sheet.png",
}  # fmt: skip
TRUTH = {"U1": [[0, 0, 10.0, 20.0], [1, 0, 30.0, 40.0]], "R1": [[0, 2, 5.0, 6.0]]}
SHIFT = st.floats(-5, 5)


@pytest.fixture(scope="module")
def passage() -> Passage:
    """The first board of the small twin."""
    return Twin(read_scenario(scenario_path("small"))).passage(0)


def shifted(passage: Passage, shift_px: float, **run: Any) -> DemoReport:
    """The report of a run whose positions are the true ones, shifted along x."""
    places = {ref: [(i, j, x + shift_px, y) for i, j, x, y in v] for ref, v in passage.truth()["views"].items()}
    return evaluate("small", RUN | run, {"quality": QUALITY, "components": places}, passage, **OUTPUT)


def test_text_headline_and_document_have_the_figures_of_run_and_truth(passage: Passage) -> None:
    report = shifted(passage, 0.05)
    assert report.ok
    text = as_text(report)
    for word in ("small", "OK", "12 ok", "399 of 504", "1 of 2", "100.700 mm/s", "61 ms", "cad 25", "0.050 px rms"):
        assert word in text, word
    assert "from the truth" not in text
    assert any("0.050 px rms" in fact for fact in headline(report))
    assert DemoReport.model_validate_json(report.model_dump_json()) == report
    assert "frames" not in report.run


def test_an_ok_verdict_that_the_truth_contradicts_is_not_ok(passage: Passage) -> None:
    report = shifted(passage, 1.2)
    assert not report.ok
    assert "more than 1 px from the truth" in as_text(report)


def test_the_guide_names_every_key_of_the_document() -> None:
    section = GUIDE.read_text(encoding="utf-8").split("### The report")[1]
    named = re.findall(r"`([a-z_.]+)`", section)
    fields = DemoReport.model_fields | {"deviation." + name: None for name in Deviation.model_fields}
    assert sorted(named) == sorted(fields.keys() - {"deviation"})


@pytest.mark.parametrize(
    ("max_px", "unplaced", "within"), [(LIMIT_PX, 0, True), (LIMIT_PX + 0.01, 0, False), (0.0, 1, False)]
)
def test_limit_and_missing_views(max_px: float, unplaced: int, within: bool) -> None:
    deviation = Deviation(views=9, unplaced=unplaced, rms_px=0, max_px=max_px, rms_mm=0, max_mm=0, worst=None)
    assert deviation.within_limit == within


@given(SHIFT, SHIFT)
def test_shift_is_measured_in_px_and_in_mm_of_each_camera(dx: float, dy: float) -> None:
    places = {"U1": [[0, 0, 10.0, 20.0], [1, 0, 30.0 + dx, 40.0 + dy]], "R1": TRUTH["R1"]}
    off = compare_with_truth(TRUTH, places, [10.0, 20.0])
    length = math.hypot(dx, dy)
    assert (off.views, off.unplaced) == (3, 0)
    assert off.max_px == pytest.approx(length, abs=1e-5)
    assert off.rms_px == pytest.approx(length / math.sqrt(3), abs=1e-5)
    assert off.max_mm == pytest.approx(length / 20, abs=1e-5)
    assert length < 1e-5 or off.worst == "U1, camera 1, row 0"
