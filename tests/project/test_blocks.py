"""Every code block of the documents is checked by its kind: commands and options exist, documents can be read.

The commands that can run do so in tests/cli/test_documented_commands.py.
"""

from __future__ import annotations

import configparser
import json
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from tests.blocks import ROOT, Block, blocks
from vaoi_station.board_data.package_sizes import parse_table
from vaoi_station.clamping.documents import ClampedRequest
from vaoi_station.cli import app
from vaoi_station.config import StationConfig
from vaoi_station.files.documents import parse, parse_toml
from vaoi_station.model import BoardType
from vaoi_station.model.part_limits import BoardLimits

ELSEWHERE = {
    ("docs/formats.md", "json"): "tests/project/test_formats_doc.py",
    ("docs/administrator.md", "nginx"): "tests/api/proxy/conftest.py",
    ("docs/plant.md", "sql"): "tests/plant/test_tables.py",
}
"""Pages whose blocks of a kind another test reads."""
PATHS = json.loads((ROOT / "tests" / "api" / "openapi.json").read_text(encoding="utf-8"))["paths"]
BOARD = {
    "name": "board",
    "fiducials": [
        {"name": "A", "x": 0.0, "y": 0.0, "diameter": 1.0},
        {"name": "B", "x": 90.0, "y": 60.0, "diameter": 1.0},
    ],
}


def calls(text: str) -> Iterator[list[str]]:
    """Yield the words of every call of `vaoi` in a command, after `vaoi` itself."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars="&|;<>")
    lexer.whitespace_split = True
    lexer.commenters = ""
    part: list[str] = []
    for word in [*lexer, ";"]:
        if not re.fullmatch("[&|;<>]+", word):
            part.append(word)
            continue
        if part[:4] == ["runuser", "-u", "vaoi", "--"]:
            part = part[4:]
        if part and (part[0] == "vaoi" or part[0].endswith("bin/vaoi")):
            yield part[1:]
        part = []


def read_call(words: list[str]) -> None:
    """Read the words of a call as the command line does, but for files, which need not exist."""
    command: Any = typer.main.get_command(app)
    context = command.context_class(command, info_name="vaoi")
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
        context = type(context)(command, parent=context)
    values, rest, _ = command.make_parser(context).parse_args(list(words))
    assert rest == [], "words that no argument takes"
    for parameter in command.params:
        value = values.get(parameter.name)
        assert not parameter.required or value not in (None, ()), f"{parameter.name} is missing"
        if value is not None and parameter.bare_type in {int, float}:
            parameter.bare_type(value)


def check_commands(block: Block) -> None:
    for command in block.commands():
        for words in calls(command) if re.search(r"\bvaoi ", command) else ():
            read_call(words)
        for method, path, query in requests(command):
            check_request(method, path, query)


def requests(command: str) -> Iterator[tuple[str, str, str]]:
    """Yield method, path and query of every request that a command makes to a station."""
    for path, query in re.findall(
        r'(?:\$STATION|\$api|http://127\.0\.0\.1:8350)(?!/api/v1$)((?:/(?:\$\([^)]*\)|[^"?\s])*)+)\??([^"\s]*)', command
    ):
        named = re.search(r"-X (\w+)", command)
        yield named[1] if named else "POST" if re.search("--json|--data-binary", command) else "GET", path, query


def check_request(method: str, path: str, query: str) -> None:
    path = path if path.startswith(("/api/", "/healthz")) else f"/api/v1{path}"
    parts = re.sub(r"\$\([^)]*\)", "X", path).split("/")
    fitting = [
        operations[method.lower()]
        for template, operations in PATHS.items()
        if method.lower() in operations and len(theirs := template.split("/")) == len(parts)
        if all(ours == other or other.startswith("{") for ours, other in zip(parts, theirs, strict=True))
    ]
    assert fitting, f"there is no {method} {path}"
    known = {parameter["name"] for operation in fitting for parameter in operation.get("parameters", ())}
    assert {part.partition("=")[0] for part in query.split("&") if part} <= known, query


def check_json(block: Block) -> None:
    document = json.loads(block.text)
    match Path(block.page).stem:
        case "clamping":
            ClampedRequest.model_validate(document)
        case "identity" | "light":
            BoardType.model_validate(BOARD | document)
        case "parts":
            BoardLimits.model_validate(document)
        case "behaviour":
            assert {"code", "detail", "action"} <= set(document) or "codes" in document
        case _:
            pytest.fail("say in check_json what this document is")


def check_toml(block: Block) -> None:
    """Read it as sizes of packages, or within the configuration of a station with real cameras."""
    table = parse_toml(block.text, str(block))
    if "package" in table:
        parse_table(block.text, str(block))
        return
    if "features" in table:
        table = {
            "cameras": [{"name": "left", "width": 64, "height": 64, "exposure_us": 100, "backend": "aravis"} | table]
        }
    station = parse_toml((ROOT / "deploy" / "station-paper.toml").read_text(encoding="utf-8"), "station-paper.toml")
    if "encoder" in table.get("line", {}):
        del station["line"]["trigger_period_s"]  # the encoder's row_mm takes its place
    for key, value in table.items():
        station[key] = station.get(key, {}) | value if isinstance(value, dict) else value
    parse(StationConfig, station, str(block))


def check_ini(block: Block) -> None:
    unit = configparser.ConfigParser(strict=True)
    unit.read_string(block.text)
    assert set(unit.sections()) <= {"Unit", "Service", "Install"}


def check_python(block: Block) -> None:
    compile(block.text, str(block), "exec")


CHECKS: dict[str, Callable[[Block], None]] = {
    "sh": check_commands,
    "console": check_commands,
    "json": check_json,
    "toml": check_toml,
    "ini": check_ini,
    "python": check_python,
}
PLAIN = frozenset({"", "text", "{toctree}"})
"""Drawings, messages and lists, in which nothing can be checked."""


@pytest.mark.parametrize("block", [b for b in blocks() if b.language not in PLAIN], ids=str)
def test_a_block_is_what_it_says(block: Block) -> None:
    if (block.page, block.language) not in ELSEWHERE:
        CHECKS[block.language](block)


def test_pages_that_other_tests_read_have_such_blocks() -> None:
    for (page, language), test in ELSEWHERE.items():
        assert any((b.page, b.language) == (page, language) for b in blocks()), page
        assert (ROOT / test).is_file()


@pytest.mark.parametrize(
    "command",
    ["vaoi plan --no", "vaoi no", "vaoi stitch A B --out x", "vaoi stitch", 'curl "$api/no"', 'curl "$api/runs?no=1"'],
)
def test_what_does_not_exist_is_found(command: str) -> None:
    with pytest.raises(Exception):  # noqa: B017, PT011  (of the parser's library, KeyError or AssertionError)
        check_commands(Block("page.md", 1, "sh", command))
