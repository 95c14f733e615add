"""Documents of station and runs: frozen, strict, and unchanged by a round trip through JSON."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.errors import BusyError
from vaoi_station.runs.states import calibration_schemas, schemas, stitching_schemas
from vaoi_station.runs.states.schemas import EventRecord, Reason, RunDetail, RunSummary, Schema
from vaoi_station.runs.states.stitching_schemas import ReferenceStatus

ALL = sorted(
    {
        cls
        for module in (schemas, calibration_schemas, stitching_schemas)
        for _, cls in inspect.getmembers(module, inspect.isclass)
        if issubclass(cls, Schema)
    },
    key=lambda cls: cls.__name__,
)


@pytest.mark.parametrize("schema", ALL, ids=lambda cls: cls.__name__)
def test_every_document_is_frozen_refuses_unknown_keys_and_is_described(schema: type[Schema]) -> None:
    assert schema.model_config["frozen"]
    assert schema.model_config["extra"] == "forbid"
    assert schema.__doc__


def test_a_reason_is_made_of_an_error() -> None:
    error = BusyError("All memory is in use.", action="Release a run.", code="ring-full")
    assert Reason.of(error) == Reason(code="ring-full", message="All memory is in use.", action="Release a run.")


def test_documents_survive_json_and_cannot_be_changed() -> None:
    event = EventRecord(number=1, time="2026-01-01T00:00:00.000Z", kind="run", state="ready", run="r1")
    assert EventRecord.model_validate_json(event.model_dump_json()) == event
    attribute: Any = "number"
    with pytest.raises(ValidationError):
        setattr(event, attribute, 2)
    with pytest.raises(ValidationError, match="unknown"):
        EventRecord.model_validate({**event.model_dump(), "unknown": 1})


def test_a_detail_has_all_fields_of_a_summary_and_a_status_those_of_its_record() -> None:
    assert RunSummary.model_fields.keys() < RunDetail.model_fields.keys()
    assert stitching_schemas.ReferenceRecord.model_fields.keys() < ReferenceStatus.model_fields.keys()
