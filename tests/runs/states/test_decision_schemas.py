"""Decisions and counts: frozen, strict, unchanged by JSON."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.decision_schemas import Decision, RunCounts

MADE: dict[str, Any] = {"choice": "use", "name": "Ada", "reason": "Hidden.", "decided": "2026-01-01T00:00:00.000Z"}


def test_documents_survive_json_and_refuse_other_choices() -> None:
    assert Decision.model_validate_json(Decision(**MADE).model_dump_json()).model_dump() == MADE
    with pytest.raises(ValidationError):
        Decision(**(MADE | {"choice": "scrap"}))
    with pytest.raises(ValidationError):
        RunCounts(since="", ok=1, degraded=0, failed=0, missed=0, other=1)  # type: ignore[call-arg]
