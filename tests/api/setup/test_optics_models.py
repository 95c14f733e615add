from __future__ import annotations

from dataclasses import MISSING, fields, replace
from typing import Any

import pytest

from vaoi_station.api.setup.optics_models import PlanOptions
from vaoi_station.errors import InputError
from vaoi_station.optics import Requirements
from vaoi_station.optics.optics_plan import make_plan
from vaoi_station.optics.paper_example import PAPER
from vaoi_station.optics.remedies import find_remedies


def test_the_parameters_are_the_requirements_of_a_plan_with_their_defaults() -> None:
    assert list(PlanOptions.model_fields) == [f.name for f in fields(Requirements)]
    for field in fields(Requirements):
        option = PlanOptions.model_fields[field.name]
        assert option.is_required() == (field.default is MISSING), field.name
        assert option.is_required() or option.default == field.default, field.name
        assert option.description, field.name
    assert PlanOptions(**vars(PAPER)).requirements() == PAPER


def _limit(name: str, key: str) -> Any:
    schema = PlanOptions.model_json_schema()["properties"][name]
    return (schema["anyOf"][0] if "anyOf" in schema else schema)[key]


@pytest.mark.parametrize("key", ["minimum", "maximum"])
def test_every_value_within_the_limits_gives_a_plan_or_a_refusal(key: str) -> None:
    refused = {}
    for name in PlanOptions.model_fields:
        try:
            plan = make_plan(replace(PAPER, **{name: _limit(name, key)}))
        except InputError as error:
            refused[name] = error.message
            continue
        if name in ("resolution_px_per_mm", "speed_mm_s"):  # the remedies of one plan take a tenth of a second
            find_remedies(plan)
    # What is refused contradicts another requirement.
    contradictions = {"minimum": {"distance_max_mm"}, "maximum": {"depth_of_field_mm", "distance_min_mm"}}
    assert refused.keys() >= contradictions[key], refused
    assert all("mm" in message for message in refused.values())
