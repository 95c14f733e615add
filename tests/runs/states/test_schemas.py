"""Documents of station and runs: frozen, strict, and unchanged by a round trip through JSON."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from vaoi_station.heights.estimates import NOTHING, Interval, PartHeight, heights_document
from vaoi_station.model import BoardType, Strict
from vaoi_station.runs.states import schemas
from vaoi_station.runs.states.schemas import (
    CameraCalibration,
    Decision,
    HeightList,
    MadeWith,
    StitchingMethod,
)

ALL = [
    cls
    for _, cls in inspect.getmembers(schemas, inspect.isclass)
    if issubclass(cls, BaseModel) and cls.__module__ == schemas.__name__
]
BOARD = BoardType.model_validate(
    {
        "name": "b",
        "outline": [[0, 0], [10, 10]],
        "components": [
            {"ref": ref, "center": [2, 2], "width": 1, "height": 1, "body_height": 1.5} for ref in ("U1", "U2", "U3")
        ],
    }
)


@pytest.mark.parametrize("schema", ALL, ids=lambda cls: cls.__name__)
def test_every_document_is_frozen_refuses_unknown_keys_and_is_described(schema: type[BaseModel]) -> None:
    assert issubclass(schema, Strict)
    assert schema.__doc__


@pytest.mark.parametrize(
    ("schema", "document"),
    [
        (MadeWith, {"configuration": "", "board_type": "", "method": "guess"}),
        (Decision, {"choice": "scrap", "name": "", "reason": "", "decided": ""}),
        (StitchingMethod, {"method": "auto", "chosen": "by chance"}),
        (CameraCalibration, {"camera": 0, "name": "left", "state": "lost"}),
    ],
)
def test_other_words_than_those_of_the_documentation_are_refused(
    schema: type[BaseModel], document: dict[str, Any]
) -> None:
    with pytest.raises(ValidationError, match="Input should be"):
        schema.model_validate(document)


def test_measured_heights_have_this_form() -> None:
    several = (Interval(0.1, 2.0, 0.6), Interval(7.0, 7.5, 0.39))
    found = {"U1": PartHeight(1.5, 0.02, (), 3), "U2": PartHeight(None, None, several, 2), "U3": NOTHING}
    document = HeightList.model_validate({"heights": heights_document(found, BOARD)})
    assert document.heights["U1"].height_mm == 1.5
    assert document.heights["U2"].comparison == "ambiguous"
    assert HeightList.model_validate_json(document.model_dump_json(exclude_none=True)) == document


@pytest.mark.parametrize(
    "entry",
    [
        {"views": 2, "height_mm": 1.5},
        {"views": 2, "sigma_mm": 0.1},
        {"views": 2, "height_mm": "1.5", "sigma_mm": 0.1},
        {"views": 2, "height_mm": True, "sigma_mm": 0.1},
        {"views": 2, "height_mm": float("nan"), "sigma_mm": 0.1},
        {"views": 2, "colour": "red"},
        {"height_mm": 1.5, "sigma_mm": 0.1},
        {"views": True},
    ],
)
def test_other_heights_are_refused(entry: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"heights\.U1"):
        HeightList.model_validate({"heights": {"U1": entry}})
