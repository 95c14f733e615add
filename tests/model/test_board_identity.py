"""Patterns of codes, and where codes may be on a board."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model import BoardIdentity, BoardType

HEADER = "[)>\x1e06\x1dP{any}\x1dS{id}\x1e\x04"


@pytest.mark.parametrize(
    ("pattern", "text", "board_id"),
    [
        (None, "SN-1", "SN-1"),
        (None, "", None),
        ("demo;{id}", "demo;SN-1", "SN-1"),
        ("demo;{id}", "demo;", None),
        ("demo;{id}", "other;SN-1", None),
        ("{id}/demo", "SN/1/demo", "SN/1"),
        ("a{id}a", "a", None),
        ("{any}-{id}", "x-y-z", "y-z"),
        ("{any};{id};{any}", "p;SN-1;r2", "SN-1"),
        ("{any};{id};{any}", "p;SN-1;", None),
        (HEADER, "[)>\x1e06\x1dPboard 7\x1dSSN-1\x1e\x04", "SN-1"),
        (HEADER, "[)>\x1e06\x1dSSN-1\x1e\x04", None),
    ],
)
def test_pattern_yields_the_id(pattern: str | None, text: str, board_id: str | None) -> None:
    assert BoardIdentity(pattern=pattern).board_id(text) == board_id


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"pattern": "demo"}, "{id} 0 times"),
        ({"pattern": "{id}-{id}"}, "{id} 2 times"),
        ({"pattern": "{id}{any}"}, "side by side"),
        ({"pattern": "-".join(["{any}"] * 17) + "-{id}"}, "the limit is 16"),
        ({"places": [{"center": [0, 0], "width": 1.0, "height": 1.0}] * 201}, "201 entries, the limit is 200"),
    ],
)
def test_refusals_name_value_and_limit(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as refused:
        BoardIdentity(**wrong)
    assert words in str(refused.value)


def test_place_off_the_board_is_refused() -> None:
    board = {"name": "b", "outline": [[0, 0], [20, 10]]}
    place = {"center": [10.0, 5.0], "width": 6.0, "height": 6.0}
    known = BoardType.model_validate({**board, "identity": {"places": [place]}})
    plain = BoardType.model_validate(board)
    assert known.identity is not None
    assert known.filmed_digest() == plain.filmed_digest()
    with pytest.raises(ValidationError, match=r"identity\.places\.1 .* reaches beyond the board"):
        BoardType.model_validate({**board, "identity": {"places": [place, {**place, "center": [10.0, 9.5]}]}})
