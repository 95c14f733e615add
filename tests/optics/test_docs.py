"""The pages on optics: the table of equations, and the output that they show."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station import optics
from vaoi_station.cli import app

ROOT = Path(__file__).resolve().parents[2]
TEXT = "\n".join(
    (ROOT / "docs" / folder / "optics.md").read_text(encoding="utf-8") for folder in ("explanation", "how-to")
)
ROWS = re.findall(r"^\|(.*)\| `(\w+)` \| `(tests/[\w/]+\.py)::(\w+)` \|$", TEXT, re.MULTILINE)
EXAMPLES = re.findall(r"^```console\n\$ ((?:[^\n]*\\\n)*[^\n]*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def test_every_numbered_equation_is_in_the_map_once() -> None:
    numbered = [m[1] for head, *_ in ROWS if (m := re.match(r" \((\d)\) \|", head))]
    assert numbered == ["1", "2", "3", "4", "5", "6"]


def test_all_rows_of_the_tables_are_tested() -> None:
    assert len(ROWS) == len(re.findall(r"^\|.*tests/", TEXT, re.MULTILINE))
    assert len({function for _, function, *_ in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("head", "function", "file", "test"), ROWS, ids=[r[1] for r in ROWS])
def test_functions_and_tests_of_the_map_exist(head: str, function: str, file: str, test: str) -> None:
    assert function in optics.__all__
    assert callable(getattr(optics, function))
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    body = next((n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == test), None)
    assert body is not None, f"{file} has no {test}"
    called = {n.func.id for n in ast.walk(body) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    assert function in called, f"{test} does not call {function}"


@pytest.mark.parametrize("number", range(1, 7))
def test_the_docstring_of_a_numbered_function_names_its_equation(number: int) -> None:
    function = next(f for head, f, *_ in ROWS if head.startswith(f" ({number}) |"))
    assert f"equation ({number})" in (getattr(optics, function).__doc__ or "")


def test_both_examples_of_the_pages_are_tested() -> None:
    assert EXAMPLES[0][0] == "vaoi plan --example paper"
    assert len(EXAMPLES) == TEXT.count("```console") == 2


@pytest.mark.parametrize(("command", "shown"), EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_output_shown_is_what_the_command_prints(command: str, shown: str) -> None:
    words = shlex.split(command.replace("\\\n", " "))
    assert words[:2] == ["vaoi", "plan"]
    result = CliRunner().invoke(app, words[1:])
    assert result.exit_code == 0
    assert result.stdout.rstrip().splitlines() == shown.rstrip().splitlines()
