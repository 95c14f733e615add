"""Statements of TOML texts, compared with what tomllib reads."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.settings.statements import statements

ROOT = Path(__file__).resolve().parents[2]
HARD = '''# A comment = "no value"
a = 1 # b = 2
"quoted.key" = 'x = # ]'
t = """
[not.a.header]
c = 1 "" # no comment"""
l = \'\'\'
] [[x]] \'\'\'
many = [ # one
  [1, 2], # two ]
  ["]", '#', { k = "}" }],
]
when = 1979-05-27 07:32:00
x.y.z = {a = 1, "b c" = [2]}

[ table . "sub" ]   # [no]
k = -1.5e3
[[list]]
n = 0
  [list.inner]
  m = 1
[[list]]
[[list.deep]]
v = true
[[list.deep]]
v = false'''


def _read(data: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        data = data[step]
    return data


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_value_stands_where_tomllib_reads_it(end: str) -> None:
    text = HARD.replace("\n", end)
    data, seen = tomllib.loads(text), []
    for statement in statements(text):
        found = _read(data, statement.path)
        if statement.kind == "value":
            begin, stop = statement.value
            assert tomllib.loads(f"value = {text[begin:stop]}")["value"] == found, statement.path
        seen.append(statement.path)
        assert text[statement.end - 1] == "\n" or statement.end == len(text)
    assert seen[:4] == [("a",), ("quoted.key",), ("t",), ("l",)]
    assert seen[6:] == [
        ("x", "y", "z"),
        ("table", "sub"),
        ("table", "sub", "k"),
        ("list", 0),
        ("list", 0, "n"),
        ("list", 0, "inner"),
        ("list", 0, "inner", "m"),
        ("list", 1),
        ("list", 1, "deep", 0),
        ("list", 1, "deep", 0, "v"),
        ("list", 1, "deep", 1),
        ("list", 1, "deep", 1, "v"),
    ]


def test_an_empty_text_has_none() -> None:
    assert list(statements("")) == list(statements("  # only a comment")) == []
