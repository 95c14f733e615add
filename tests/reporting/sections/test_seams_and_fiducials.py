"""Seams between cameras, and fiducials."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.seams_and_fiducials import fiducials, seams


def with_quality(stitched: StitchedRun, **quality: Any) -> StitchedRun:
    """Return the run with other quality figures."""
    result = stitched.result.model_copy(update={"quality": stitched.result.quality | quality})
    return replace(stitched, result=result)


def test_one_seam_with_the_links_between_the_two_cameras(stitched: StitchedRun) -> None:
    html = seams(stitched).html()
    used = stitched.result.quality["links"]["neighbours"]["used"]
    assert html.count("<tr>") == 2
    assert f'<td>0 – 1</td><td class="n">{used}</td>' in html


def test_seam_without_links_is_reported(stitched: StitchedRun) -> None:
    assert "no links" in seams(replace(stitched, findings=replace(stitched.findings, links=()))).html()


def test_every_fiducial_is_a_row_and_every_detection_a_dot(stitched: StitchedRun) -> None:
    listed, html = stitched.result.quality["fiducials"], fiducials(stitched).html()
    for fiducial in listed:
        assert f"<td>{fiducial['name']}</td>" in html
    points = stitched.findings.problem.fiducials
    assert points is not None
    assert html.count('fill-opacity="0.75"') == int((points.which >= 0).sum())


def test_fiducial_that_was_not_found_has_no_residual(stitched: StitchedRun) -> None:
    absent = [{"name": "FID9", "sightings": 0, "residual_px": None}]
    html = fiducials(with_quality(stitched, fiducials=absent)).html()
    assert html.count('<td class="n">–</td>') == 3


def test_board_that_was_not_found_is_reported(stitched: StitchedRun) -> None:
    assert "The board was not found." in fiducials(with_quality(stitched, fiducials=[])).html()
