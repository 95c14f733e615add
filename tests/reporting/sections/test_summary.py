"""Verdict, reasons and key numbers."""

from __future__ import annotations

from dataclasses import replace

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.summary import head, key_numbers


def test_head_shows_verdict_size_and_method(stitched: StitchedRun) -> None:
    html = head(stitched, "run <1>")
    assert "<h1>run &lt;1&gt;" in html
    assert '<span class="verdict">ok</span>' in html
    assert f"2 cameras × {stitched.head.rows} rows · method auto" in html
    assert "<ul>" not in html


def test_reasons_are_listed(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"reasons": ("a < b", "second")})
    assert head(replace(stitched, result=result), "r").endswith("<ul><li>a &lt; b</li><li>second</li></ul></header>")


def test_key_numbers_are_those_of_the_result(stitched: StitchedRun) -> None:
    html, q = key_numbers(stitched).html(), stitched.result.quality
    assert f"<dd>{q['residual_px']['median']:.3f} px</dd>" in html
    assert f"{q['links']['rows']['used']} used of {q['links']['rows']['found']}" in html
    present = len(stitched.opened.present)
    assert f"{present} of {present} delivered, {present} placed" in html


def test_unknown_values_are_dashes(stitched: StitchedRun) -> None:
    quality = stitched.result.quality | {
        "cad_sigma_px": None, "scale_error": None, "outline_contrast": None, "component_sigma_px": {},
        "belt": {"measured_mm_s": None, "nominal_mm_s": [0.0, 100.0], "speed_error": None},
    }  # fmt: skip
    result = stitched.result.model_copy(update={"quality": quality, "components": None})
    assert key_numbers(replace(stitched, result=result)).html().count("<dd>–</dd>") == 5
