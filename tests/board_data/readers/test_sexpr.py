from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.readers.sexpr import every, first, numbers, parse_sexpr, text_of
from vaoi_station.errors import InputError


def test_lists_texts_and_numbers() -> None:
    node = parse_sexpr('(a (at 1.5 -2 90) (name "x \\"y\\"\\n") (b) (b 2))', "f")
    assert numbers(first(node, "at")) == [1.5, -2, 90]
    assert text_of(node, "name") == 'x "y"\n'
    assert [n[1:] for n in every(node, "b")] == [[], ["2"]]
    assert (text_of(node, "none", "d"), numbers(None)) == ("d", [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("(a (b)", r"f: ends within a list: 1 '\)' are missing"),
        ("\n)", r"f: has a '\)' without '\(', line 2"),
        ("(" * 300, "f: is nested deeper than 200 levels, line 1"),
        ("", r"f: ends within a list: 0 '\)' are missing"),
    ],
)
def test_wrong_texts_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_sexpr(text, "f")


@given(st.text(alphabet='()" \\ab1.\n', max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(InputError):
        assert isinstance(parse_sexpr(text, "f"), list)
