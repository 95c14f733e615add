"""The demo report as text, as JSON, and in its description."""

from __future__ import annotations

import re
from pathlib import Path

from pydantic import BaseModel

from tests.demo.conftest import Evaluate
from vaoi_station.demo.demo_report import DemoReport, as_text, headline

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "engineering" / "demo.md"


def test_text_and_headline_hold_the_figures(evaluated: Evaluate) -> None:
    report = evaluated(shift_px=0.05)
    text = as_text(report)
    for word in ("small", "OK", "12 ok", "399 of 504", "1 of 2", "100.700 mm/s", "61 ms", "cad 25", "0.050 px rms"):
        assert word in text, word
    assert any("0.050 px rms" in fact for fact in headline(report))


def test_text_of_a_failed_run_holds_its_reasons(evaluated: Evaluate) -> None:
    reasons = [{"code": "stitch-failed", "message": "The board lies turned by 180 degrees."}]
    text = as_text(evaluated({"verdict": "failed", "reasons": reasons, "belt": None, "timings": {}}))
    assert "FAILED" in text
    assert "- The board lies turned by 180 degrees." in text
    assert "? mm/s measured" in text


def test_text_reports_an_ok_verdict_that_the_truth_contradicts(evaluated: Evaluate) -> None:
    assert "more than 1 px from the truth" in as_text(evaluated(shift_px=1.2))
    assert "from the truth, or" not in as_text(evaluated())


def test_json_round_trip(evaluated: Evaluate) -> None:
    report = evaluated()
    assert DemoReport.model_validate_json(report.model_dump_json()) == report


def keys(model: type[BaseModel], before: str = "") -> list[str]:
    found = []
    for name, field in model.model_fields.items():
        inner = field.annotation
        nested = isinstance(inner, type) and issubclass(inner, BaseModel)
        found += keys(inner, f"{before}{name}.") if nested else [before + name]  # type: ignore[arg-type]
    return found


def test_description_names_every_key() -> None:
    table = GUIDE.read_text(encoding="utf-8").split("### The report")[1]
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    assert [name for cell in cells for name in re.findall(r"`([^`]*)`", cell)] == keys(DemoReport)
