from __future__ import annotations

import tracemalloc

import pytest
from pydantic import ValidationError

from vaoi_station.model import Finite, FrozenModel, Positive, Whole
from vaoi_station.model.frozen_model import Matrix, Point
from vaoi_station.runs.states.schemas import EventRecord


class Sample(FrozenModel):
    any_number: Finite = 0.0
    length: Positive = 1.0
    count: Whole = 0
    point: Point = (0.0, 0.0)
    matrix: Matrix | None = None


def test_user_keys_are_kept_and_unknown_keys_refused() -> None:
    assert Sample.model_validate({"x_note": "hello"}).model_extra == {"x_note": "hello"}
    with pytest.raises(ValidationError, match=r"unknown key.*'note'.*'x_'"):
        Sample.model_validate({"note": "hello"})


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ([[1, 0], [0, 1]], r"has shape \(2, 2\), must be 3×3"),
        ([[1, 0, 0], [0, 1], [0, 0, 1]], "rows of different lengths"),
        ([["1", "0", "0"]] * 3, "not a matrix of numbers"),
        ([[True, 0, 0], [0, 1.0, 0], [0, 0, 1]], "not a matrix of numbers"),
        ([[1.5, 0, 0], [0, 1.0, 0], [0, 0, True]], "not a matrix of numbers"),
        ([[1e308, 0, 0], [0, 1.0, 0], [0, 0, 1]], r"largest entry of 1e\+308 \(absolute\), must be between"),
        ([[1e-300, 0, 0], [0, 1e-300, 0], [0, 0, 1e-300]], "largest entry of 1e-300"),
        ([[1.0, 0, 0], [0, 10**400, 0], [0, 0, 1]], "limit of ±1e|matrix of numbers"),
        ([[True, False, False]] * 3, "not a matrix of numbers"),
        ([[1, 0, 0], [0, float("nan"), 0], [0, 0, 1]], "NaN or infinite"),
        ([[1, 2, 3], [2, 4, 6], [0, 0, 1]], "is singular"),
        ([[1, 0, 0], [0, 0, 0], [0, 0, 1]], "is singular"),
    ],
)
def test_invalid_matrices_are_refused(bad: object, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Sample.model_validate({"matrix": bad})


@pytest.mark.parametrize("field", ["any_number", "length", "count"])
def test_absurd_numbers_are_refused_with_the_limit(field: str) -> None:
    for bad in (1e308, 10**30) if field != "count" else (10**30,):
        with pytest.raises(ValidationError, match="less than"):
            Sample.model_validate({field: bad})


def test_texts_of_documents_are_not_kept_in_memory() -> None:
    """A service reads documents with other ids and times for months."""
    texts = [f'{{"number": {k}, "time": "time {k}", "kind": "run", "message": "board {k}"}}' for k in range(3000)]
    for document in texts[:100]:
        EventRecord.model_validate_json(document)
    tracemalloc.start()
    try:
        for document in texts:
            EventRecord.model_validate_json(document)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 50_000
