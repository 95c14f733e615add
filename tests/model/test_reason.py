"""The codes of reasons: documented one by one, each in use, and one with every reason of a result."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.model.codes import code_sections

ROOT = Path(__file__).resolve().parents[2]
RESULT: dict[str, Any] = {
    "method": "auto",
    "image_matrices": [[]],
    "cad_matrix": None,
    "row_motion": [],
    "status": Status.FAILED,
}


def test_the_list_of_codes_has_every_code_once() -> None:
    (section,) = (s for s in code_sections() if s.title == "Reasons of a result")
    listed = [code for entry in section.codes for code in entry.codes]
    assert sorted(listed) == sorted(code.value for code in ReasonCode)


def test_every_code_is_kebab_case_and_in_use() -> None:
    sources = "".join(path.read_text() for path in (ROOT / "vaoi_station" / "stitching").rglob("*.py"))
    for code in ReasonCode:
        assert re.fullmatch("[a-z]+(-[a-z]+)*", code)
        assert f"ReasonCode.{code.name}" in sources, code


def test_a_result_has_a_code_for_every_reason_or_none_at_all() -> None:
    assert Stitch.model_validate(RESULT | {"reasons": ["one", "two"]}).reason_codes == ()
    Stitch.model_validate(RESULT | {"reasons": ["one"], "reason_codes": ["no-frames"]})
    with pytest.raises(ValidationError, match="reason_codes has 1 entries, must have 2"):
        Stitch.model_validate(RESULT | {"reasons": ["one", "two"], "reason_codes": ["no-frames"]})
