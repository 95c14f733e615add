"""Request and response models of the REST interface."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.api.rest_models import (
    ArmRequest,
    ComponentViews,
    CorrectionRequest,
    DecisionRequest,
    IdentityReport,
    MethodRequest,
    RunPage,
    StateRequest,
    TeachRequest,
)
from vaoi_station.model import Strict


@pytest.mark.parametrize(
    "wrong",
    [
        {"runs": 0},
        {"runs": 1_000_001},
        {"board_type": "x" * 201},
        {"boardtype": "x"},
        {"runs": "many"},
        {"allow_lost_cameras": "perhaps"},
    ],
)
def test_wrong_orders_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ArmRequest.model_validate(wrong)


def test_an_order_may_be_empty() -> None:
    assert ArmRequest.model_validate({}).model_dump(exclude_none=True) == {}


@pytest.mark.parametrize("method", ["auto", "fiducials", "features", "reference"])
def test_the_documented_methods_are_accepted(method: str) -> None:
    assert MethodRequest.model_validate({"method": method}).method == method


def test_unknown_methods_and_empty_run_ids_are_refused() -> None:
    with pytest.raises(ValidationError):
        MethodRequest.model_validate({"method": "magic"})
    with pytest.raises(ValidationError):
        TeachRequest.model_validate({"run": ""})


def test_unknown_fields_are_left_out_of_the_json() -> None:
    assert json.loads(RunPage(runs=[]).model_dump_json(exclude_none=True)) == {"runs": []}
    views = ComponentViews(address="U1", px_per_mm=None, views=[])
    assert json.loads(views.model_dump_json(exclude_none=True)) == {"address": "U1", "views": []}


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (StateRequest, {"state": "draft", "revision": "C"}),
        (CorrectionRequest, {"run": "r1", "revision": "C"}),
        (DecisionRequest, {"choice": "use", "name": "Ann", "reason": "good enough"}),
        (IdentityReport, {"board_id": "SN-1", "machine": "AOI 2"}),
    ],
)
def test_texts_have_no_control_characters(model: type[Strict], fields: dict[str, str]) -> None:
    assert model.model_validate(fields).model_dump(mode="json") == fields
    for name in set(fields) & {"revision", "name", "reason", "board_id", "machine"}:
        with pytest.raises(ValidationError, match="String should match pattern"):
            model.model_validate(fields | {name: "a\tb"})
