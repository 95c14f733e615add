"""Answers about cameras: what is not known is left out, and what a later version adds is read."""

from __future__ import annotations

from vaoi_station.api.cameras.models import Examination, SharpnessTile


def test_a_part_without_edges_has_no_blur() -> None:
    assert SharpnessTile(column=0, row=2).model_dump(exclude_none=True) == {"column": 0, "row": 2}


def test_a_report_of_the_doctor_with_further_fields_is_read() -> None:
    report = {"format": "vaoi-doctor", "created": "now", "worst": "ok", "findings": []}
    assert Examination.model_validate(report).worst == "ok"
