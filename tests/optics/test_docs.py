"""The page on optics: the table of equations."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vaoi_station import optics

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "explanation" / "optics.md").read_text(encoding="utf-8")
TESTS = (ROOT / "tests" / "optics" / "test_equations.py").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (.*?) \|.*\| `(\w+)` \|$", PAGE, re.MULTILINE)


def test_every_numbered_equation_is_in_the_map_once() -> None:
    numbered = [m[1] for head, _ in ROWS if (m := re.fullmatch(r"\((\d)\)", head))]
    assert numbered == ["1", "2", "3", "4", "5", "6"]


def test_every_function_of_the_map_is_in_it_once() -> None:
    assert len(ROWS) == len(re.findall(r"^\|.*\| `\w+` \|$", PAGE, re.MULTILINE))
    assert len({function for _, function in ROWS}) == len(ROWS)


@pytest.mark.parametrize("function", [function for _, function in ROWS])
def test_every_function_of_the_map_exists_and_is_tested(function: str) -> None:
    assert function in optics.__all__
    assert callable(getattr(optics, function))
    assert re.search(rf"\b{function}\(", TESTS), f"no test of the equations calls {function}"


@pytest.mark.parametrize("number", range(1, 7))
def test_the_docstring_of_a_numbered_function_names_its_equation(number: int) -> None:
    function = next(f for head, f in ROWS if head == f"({number})")
    assert f"equation ({number})" in (getattr(optics, function).__doc__ or "")
