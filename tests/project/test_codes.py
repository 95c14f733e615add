"""model/codes.toml, from which docs/codes.md is made, lists every code that the package can give."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from vaoi_station.acquisition.pairing.proof import ACTIONS, Kind
from vaoi_station.api.problems import KINDS
from vaoi_station.model import ReasonCode, Status
from vaoi_station.model.codes import code_sections
from vaoi_station.model.recording import Verdict
from vaoi_station.store.storage_trouble import CODES

ROOT = Path(__file__).resolve().parents[2]
FAMILIES = {
    "stitch-": {f"stitch-{status}" for status in Status if status is not Status.OK},
    "frames-": {f"frames-{verdict}" for verdict in Verdict if verdict is not Verdict.OK},
    "trigger-": {f"trigger-{kind}" for kind in ACTIONS},
}
"""Codes that are composed when they are given, by their first part."""
BASE_CLASS = "error"
"""Code of the base class of errors, of which no error is made."""


def given_codes() -> Iterator[str]:
    """Yield the codes in the package's sources; a composed one as its first part."""
    for path in sorted((ROOT / "vaoi_station").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for value in _values(node):
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    yield value.value
                elif isinstance(value, ast.JoinedStr):
                    first = value.values[0]
                    assert isinstance(first, ast.Constant), ast.unparse(value)
                    yield str(first.value)


def _values(node: ast.AST) -> Iterator[ast.expr | None]:
    """Yield what a node of a syntax tree gives as a code: an argument, a class attribute or a constant of a module."""
    match node:
        case ast.keyword(arg="code", value=value) | ast.Assign(targets=[ast.Name(id="code" | "CODE")], value=value):
            yield value
        case ast.Call(
            func=ast.Attribute(attr="add_reason")
            | ast.Name(id="Note" | "noted" | "add_conflict" | "fault" | "warning"),
            args=[value, *_],
        ):
            yield value


def test_the_list_has_every_code() -> None:
    given = set(given_codes()) - {"", BASE_CLASS}
    composed = {code for code in given if code.endswith("-")}
    assert composed == set(FAMILIES)
    expected = (given - composed).union(KINDS, CODES, ReasonCode, *FAMILIES.values())
    listed = {code for section in code_sections() for entry in section.codes for code in entry.codes}
    assert sorted(listed) == sorted(expected)


def test_every_code_has_a_meaning_and_an_action() -> None:
    entries = [entry for section in code_sections() for entry in section.codes]
    assert [e for e in entries if not e.meaning.strip() or not e.action.strip()] == []


def test_no_section_lists_a_code_twice() -> None:
    for section in code_sections():
        listed = [code for entry in section.codes for code in entry.codes]
        assert len(listed) == len(set(listed)), section.title


def test_findings_without_an_action_are_no_reasons() -> None:
    """They explain missing frames only, so they are not in the list."""
    assert set(get_args(Kind)) - set(ACTIONS) == {"ignored-trigger"}
