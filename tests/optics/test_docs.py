"""The pages on optics: the table of equations, and the output that they show."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station import optics
from vaoi_station.cli import app

ROOT = Path(__file__).resolve().parents[2]
PAGE, TEXT = ((ROOT / "docs" / f / "optics.md").read_text(encoding="utf-8") for f in ("explanation", "how-to"))
TESTS = (ROOT / "tests" / "optics" / "test_equations.py").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (.*?) \|.*\| `(\w+)` \|$", PAGE, re.MULTILINE)
EXAMPLES = re.findall(r"^```console\n\$ ((?:[^\n]*\\\n)*[^\n]*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


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


def test_the_example_of_the_pages_is_tested() -> None:
    assert len(EXAMPLES) == TEXT.count("```console") >= 1


@pytest.mark.parametrize(("command", "shown"), EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_output_shown_is_what_the_command_prints(command: str, shown: str) -> None:
    words = shlex.split(command.replace("\\\n", " "))
    assert words[:2] == ["vaoi", "plan"]
    result = CliRunner().invoke(app, words[1:])
    assert result.exit_code == 0
    # "…" stands for lines that are left out.
    printed = iter(result.stdout.splitlines())
    assert [line for line in shown.splitlines() if line != "…" and line not in printed] == []
