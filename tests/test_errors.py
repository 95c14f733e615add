"""Errors keep code, status and action, also across processes."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from vaoi_station import errors
from vaoi_station.errors import InputError, VaoiError

CLASSES = [c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, VaoiError)]


@pytest.mark.parametrize("kind", CLASSES, ids=lambda c: c.__name__)
def test_errors_cross_process_borders_unchanged(kind: type[VaoiError]) -> None:
    error = kind("ring is full: 3 of 3 runs are leased.", action="Release one.", code="ring-full")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert (again.message, again.action, again.code, again.status) == (
        error.message,
        "Release one.",
        "ring-full",
        kind.status,
    )
    assert str(again) == str(error) == "ring is full: 3 of 3 runs are leased. Release one."


def test_every_class_has_a_separate_code() -> None:
    assert len({c.code for c in CLASSES}) == len(CLASSES)
    assert {c.__name__: c.status for c in CLASSES} == {
        "VaoiError": 500,
        "InputError": 422,
        "NotFoundError": 404,
        "GoneError": 410,
        "StateError": 409,
        "BusyError": 503,
        "DeviceError": 503,
        "InternalError": 500,
    }


def test_a_field_error_names_file_key_value_and_limit() -> None:
    error = InputError.field(Path("board.json"), "unit", "cm", "'mm', 'inch' or 'mil'", "Convert the file.")
    assert str(error) == "board.json: unit is 'cm', but must be 'mm', 'inch' or 'mil'. Convert the file."


def test_long_values_are_cut() -> None:
    text = str(InputError.field("request", "name", "x" * 500, "shorter"))
    assert len(text) < 130
    assert "…" in text
