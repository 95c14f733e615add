"""Write the pages that are made of the code: docs/codes.md, and in docs/reference the addresses of REST, the commands,
the keys of files, scenarios and station.toml, the metrics, the modules, and the tables of a plant.

python docs/generate.py           # after a change of the interface, the command line or the configuration
python docs/generate.py --check   # ends with 1 if a page is outdated (tests/project does the same)
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args, get_origin
from urllib.parse import quote

import typer.main
from pydantic import BaseModel

from vaoi_station.api.access import scope_needed
from vaoi_station.api.problems import KINDS
from vaoi_station.api.routes.metrics import metrics
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.cli import app
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import BoardType, Calibration, RecordingHead, Stitch
from vaoi_station.model.codes import code_sections
from vaoi_station.photometry.flat_fields import FlatFieldDocument
from vaoi_station.plant.manifest import ArchivedRun
from vaoi_station.plant.tables import KEY, TABLES
from vaoi_station.runs.archive.finished_runs import RunFigures
from vaoi_station.runs.archive.storage_watch import StorageFigures
from vaoi_station.runs.states.schemas import HeightEntry, PartsDocument
from vaoi_station.settings.keys import Setting, documentation, keys
from vaoi_station.simulation.scenario import Scenario

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
OPENAPI = ROOT / "tests" / "api" / "openapi.json"
"""The interface as published; tests/api/test_openapi.py holds it equal to the program's."""
HEAD = "<!-- Written by docs/generate.py: change its source, not this page. -->\n\n"
SECTIONS = {
    "runs": "Runs",
    "pictures": "Pictures",
    "station": "Station and orders",
    "board-types": "Board types",
    "access": "Keys and logins",
    "setup": "Setting up",
}
"""Titles of the tags that name themselves badly."""
HEADERS = {
    "Idempotency-Key": "a new text in quotes for each command: repeated with it, the command acts once",
    "If-Match": "the ETag of what was read: refused with 412 if it has changed since",
    "If-None-Match": "`*`: refused with 412 if there is one already",
}
"""Headers that mean the same at every address."""
COMMON = {"400", "401", "403", "408", "413", "421", "422", "500", "503", "304"}
"""Replies that every address may give; the page states them once."""
REST_HEAD = """# REST addresses

All addresses begin with `/api/v1/`, but those that begin with `/`. [The guide](../rest.md) explains how to use them; a
station shows this page with forms under `/docs`.

Every address may refuse with 400 (malformed), 401 (key needed), 403 (beyond the key's scope), 408 and 413 (body too
slow, too large), 421 (unknown host name), 422 (a value outside its limits), 500 and 503 (busy). A refusal is a problem
document with a `code` ([codes](../codes.md)). `GET` with `If-None-Match` gives 304.

Try an address: `curl "http://127.0.0.1:8350/api/v1/runs?limit=1"`; with another method `curl -X PUT "…"`, with a body
`curl --json '{…}' "…"`.
"""
COMMANDS_HEAD = """# Commands

Exit status: 0 without errors, 2 for wrong input, 3 for a device or the present state, 4 for an internal error. `vaoi
check-config` and `vaoi doctor`: 0 without problems, 1 with warnings, 2 with faults.
"""
SETTINGS_HEAD = """# Keys of station.toml

`[]` after a name: one table for each element, as `[[cameras]]`. `NAME`: a name that you choose. *required*: the table
needs it; *optional table*: the table may be absent. [How to configure a station](../configuration.md).
"""
MODULES_HEAD = """# Modules

Each with the first sentence of its docstring, from the bottom of the import order to its top where a contract of
pyproject.toml states one: a module may import what stands above it. How they work together:
[architecture](../architecture.md).
"""
CODES_HEAD = """# Codes

Every reason, warning, fault and refusal has a `code` for programs, a `message` and mostly an `action` for people. Codes
are never renamed; sentences may change. A station explains each code at `/problems/CODE`. Cases that need more words:
[troubleshooting](troubleshooting.md).
"""
DOCUMENTS_HEAD = """# Keys of files

What stands in the files of [the formats](../formats.md). `[]` after a name: one object for each element. `NAME`: a name
that you choose. *required*: a file without it is refused. A key without a default that is not required may be absent;
texts call it *empty* then.
"""
SCENARIO_HEAD = """# Keys of a scenario

Scenario files of [the twin](twin.md). Every table may be absent. *Empty* in a text: without a value.
"""
METRICS_HEAD = """# Metrics

`GET /metrics` replies in the text format of Prometheus (0.0.4). Counters begin at zero with every start of the station,
unless stated. How to set up Prometheus, alerts and a dashboard: [logs and monitoring](logs.md).

Do not add up `vaoi_process_resident_bytes`: memory that workers share with the fork server counts in each of them.
"""
TABLES_HEAD = """# Tables of a plant

`OUT/tables/TABLE/part-NNNNN.parquet`, which `vaoi restitch` writes, sorted by station, day and run. Every table has
both results of a run, distinguished by the column `result`. Null stands for what a result does not state. The schema,
with the meaning of each column, is in the files as well. How to ask them: [plant](../plant.md#questions).
"""
DOCUMENTS: dict[str, type[BaseModel]] = {
    "recording.json": RecordingHead,
    "calibration.json": Calibration,
    "layout.json": Layout,
    "board.json": BoardType,
    "result.json": Stitch,
    "flatfield.json": FlatFieldDocument,
    "Heights": HeightEntry,
    "Measures of parts": PartsDocument,
    "A check of a board type": BoardCheck,
    "The manifest of an archived run": ArchivedRun,
}
RELEASES = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))
    for path in sorted(OPENAPI.parent.joinpath("released").glob("*.json"))
}
"""The operations of each released version, oldest first."""
PROPOSAL = "proposal"
"""Key of a check that holds a whole board type, whose keys the page has already."""
EXAMPLE_LINES, EXAMPLE_WIDTH = 16, 110


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(map(_cell, row)) + " |"
    yield ""


def _limits(schema: dict[str, Any]) -> str:
    """Return type, choices and limits of a schema in words."""
    if "enum" in schema:
        return ", ".join(f"`{choice}`" for choice in schema["enum"])
    if schema.get("type") == "array":
        return f"{_limits(schema.get('items', {}))}, several"
    words = schema.get("format", "") if schema.get("format") in {"date-time"} else schema.get("type", "")
    low, high = (
        schema.get("minimum", schema.get("exclusiveMinimum")),
        schema.get("maximum", schema.get("exclusiveMaximum")),
    )
    if low is not None and high is not None:
        return f"{words}, {low:g} to {high:g}"
    if low is not None:
        return f"{words}, from {low:g}"
    return f"{words}, up to {high:g}" if high is not None else words


def _example(content: dict[str, Any]) -> str | None:
    """Return the first example of a body, one line for each of its members."""
    example = next(
        (body["example"] for kind, body in content.items() if kind.endswith("json") and "example" in body), None
    )
    if not isinstance(example, dict):
        return None if example is None else _line(example)
    members = [f"  {json.dumps(key)}: {_line(value)}" for key, value in example.items()]
    more = ["  …"] if len(members) > EXAMPLE_LINES else []
    return "{\n" + ",\n".join(members[:EXAMPLE_LINES] + more) + "\n}"


def _line(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= EXAMPLE_WIDTH else text[: EXAMPLE_WIDTH - 2] + " …"


def _operation(method: str, path: str, operation: dict[str, Any], schemas: dict[str, Any]) -> Iterator[str]:
    # An underscore before a word would begin italics.
    yield f"### {method.upper()} {path.removeprefix('/api/v1/')}".replace("_files", r"\_files").replace("}_{", r"}\_{")
    yield ""
    purpose, _, more = operation.get("description", "").partition("\n\n")
    scope = scope_needed(method.upper(), path)
    since = next(
        (v for v, known in RELEASES.items() if f"{method.upper()} {path.removeprefix('/api/v1/')}" in known), None
    )
    age = f" Since {since}." if since else " Not released yet."
    old = " **Deprecated.**" if operation.get("deprecated") else ""
    yield " ".join(purpose.split()) + (f" Scope: {scope}." if scope else "") + age + old
    yield ""
    if more:
        yield from (" ".join(part.split()) + "\n" for part in more.split("\n\n"))
    rows = []
    parameters = operation.get("parameters", ())
    wanted = operation.get("requestBody", {}).get("content", {})
    reference = wanted.get("application/json", {}).get("schema", {}).get("$ref", "").rsplit("/", 1)[-1]
    model = schemas.get(reference, {})
    members = model.get("properties", {})
    for parameter in parameters:
        name, schema = parameter["name"], parameter["schema"]
        if name in HEADERS:
            continue
        default = schema.get("default")
        stated = "required" if parameter.get("required") and parameter["in"] != "path" else ""
        # What a body may state as well is described there.
        meaning = parameter.get("description") or members.get(name, {}).get("description", "")
        either = f"`{name}` (query or body)" if name in members else f"`{name}`"
        rows.append((either, meaning, _limits(schema), stated if default in (None, "") else f"`{default}`"))
    named = {parameter["name"] for parameter in parameters}
    needed = model.get("required", ())
    for name, schema in members.items():
        if name in named:
            continue
        default = "required" if name in needed else "" if schema.get("default") is None else f"`{schema['default']}`"
        rows.append((f"`{name}` (body)", schema.get("description", ""), _limits(schema), default))
    if rows:
        yield from _table(("parameter", "meaning", "values", "default"), rows)
    replies = {s: r.get("content", {}) for s, r in operation["responses"].items() if s.startswith("2")}
    sent = _example(wanted)
    if not sent and (wanted or not any(map(_example, replies.values()))):
        yield f"Example: `{_request(method, path, parameters)}`\n"
    if sent:
        yield f"Body:\n\n```json\n{sent}\n```\n"
    for status, reply in operation["responses"].items():
        if status.startswith("2"):
            kinds = ", ".join(f"`{kind}`" for kind in reply.get("content", {}))
            shown = _example(reply.get("content", {}))
            yield (
                f"Reply {status}{': ' + kinds if kinds else ''}{'' if shown else '.'}"
                + (f"\n\n```json\n{shown}\n```" if shown else "")
                + "\n"
            )
    kinds = {str(status): kind for kind, (status, _, _) in reversed(KINDS.items())}
    own = [
        f"{status} `{kinds[status]}`" for status in operation["responses"] if status[0] in "45" and status not in COMMON
    ]
    if own:
        yield f"Refused also with {', '.join(own)}.\n"


def _request(method: str, path: str, parameters: Iterable[dict[str, Any]]) -> str:
    """Return a request with the examples of its parameters; of those in the query, only the ones that it needs."""
    query = []
    for parameter in parameters:
        name, schema = parameter["name"], parameter["schema"]
        example = parameter.get("example", schema.get("enum", [schema.get("minimum", "")])[0])
        value = quote(str(example[0] if isinstance(example, list) else example), safe=",")
        path = path.replace(f"{{{name}}}", value)
        if parameter["in"] == "query" and value and (parameter.get("required") or name in {"format", "component"}):
            query.append(f"{name}={value}")
    return f"{method.upper()} {path}" + (f"?{'&'.join(query)}" if query else "")


def addresses() -> str:
    """Return the page of all REST addresses."""
    document = json.loads(OPENAPI.read_text(encoding="utf-8"))
    stated = [(f"`{name}`", text) for name, text in HEADERS.items()]
    lines = [REST_HEAD, *_table(("header of commands", "meaning"), stated)]
    groups: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            groups.setdefault(operation.get("tags", ["station"])[0], []).append((method, path, operation))
    for tag in sorted(groups, key=lambda tag: (list(SECTIONS).index(tag) if tag in SECTIONS else 9, tag)):
        lines += [f"## {SECTIONS.get(tag, tag.capitalize())}\n"]
        for method, path, operation in groups[tag]:
            lines += _operation(method, path, operation, document["components"]["schemas"])
    return HEAD + "\n".join(lines).rstrip() + "\n"


def commands() -> str:
    """Return the page of all commands of `vaoi`."""
    lines = [COMMANDS_HEAD]

    def visit(group: Any, prefix: str) -> None:
        for name, command in sorted(group.commands.items()):
            if hasattr(command, "commands"):
                visit(command, f"{prefix}{name} ")
                continue
            arguments = [p for p in command.params if p.param_type_name == "argument"]
            words = " ".join(f"{p.name.upper()}{'…' if p.nargs == -1 else ''}" for p in arguments)
            lines.append(f"## vaoi {prefix}{name}\n")
            lines.append(f"```sh\nvaoi {prefix}{name}{' ' + words if words else ''}\n```\n")
            lines.extend(" ".join(part.split()) + "\n" for part in (command.help or "").split("\n\n"))
            rows = []
            for p in command.params:
                option = p.param_type_name == "option"
                text = (getattr(p, "help", None) or "").strip()
                default = (
                    ""
                    if p.default in (None, False, ()) or callable(p.default)
                    else f"`{getattr(p.default, 'value', p.default)}`"
                )
                shown = ", ".join(f"`{o}`" for o in p.opts) if option else f"`{p.name.upper()}`"
                rows.append((shown, text, default or ("required" if p.required and option else "")))
            if rows:
                lines.extend(_table(("option", "meaning", "default"), rows))

    visit(typer.main.get_command(app), "")
    return HEAD + "\n".join(lines).rstrip() + "\n"


def _values(setting: Setting) -> str:
    if setting.choices:
        return ", ".join(f"`{choice}`" for choice in setting.choices)
    low = setting.minimum if setting.minimum is not None else setting.above
    high = setting.maximum if setting.maximum is not None else setting.below
    limits = (
        f"{low:g} to {high:g}"
        if low is not None and high is not None
        else f"from {low:g}"
        if low is not None
        else f"up to {high:g}"
        if high is not None
        else ""
    )
    if setting.above is not None and high is None:
        limits = f"above {setting.above:g}"
    return " ".join(filter(None, (limits or setting.kind, setting.unit)))


def _rows(found: Iterable[Setting]) -> Iterator[str]:
    """Yield the table of keys that are in one table of a document."""
    rows = []
    for setting in found:
        name = setting.key.removeprefix(setting.table).lstrip(".")
        default = "required" if setting.required else f"`{setting.default}`" if setting.default is not None else ""
        meaning = setting.description or ("always this" if len(setting.choices) == 1 else "")
        rows.append((f"`{name}`", meaning, _values(setting), default))
    return _table(("key", "meaning", "values", "default"), rows)


def settings() -> str:
    """Return the page of all keys of station.toml."""
    lines = [SETTINGS_HEAD]
    for table, found in groupby(keys(), lambda setting: setting.table):
        inside = list(found)
        title = f"[{table}]" if table else "The file itself"
        lines += [f"## {title}{', optional table' if inside[0].optional_table else ''}\n", *_rows(inside)]
    return HEAD + "\n".join(lines).rstrip() + "\n"


def _inner(annotation: Any) -> tuple[type[BaseModel], str] | None:
    """Return the model that a field holds, and what its path gets: `[]` for a list, `.NAME` for a map."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, ""
    for found in filter(None, map(_inner, get_args(annotation))):
        suffix = {tuple: "[]", list: "[]", dict: ".NAME"}.get(get_origin(annotation), "")
        return found[0], suffix + found[1]
    return None


def _models(model: type[BaseModel], path: str = "") -> Iterator[tuple[str, type[BaseModel], str]]:
    """Yield path, model and text of each table inside a document, outer ones first."""
    inside = []
    for name, field in model.model_fields.items():
        if (found := _inner(field.annotation)) and name != PROPOSAL:
            where = f"{path}.{name}{found[1]}" if path else name + found[1]
            text = documentation(model).get(name) or field.description or ""
            text += " Required." if text and field.is_required() else ""
            inside.append((where, found[0], text))
    for where, held, text in inside:
        yield where, held, text
        yield from _models(held, where)


def _document(root: type[BaseModel], title: Callable[[str], str]) -> Iterator[str]:
    """Yield the tables of a document; `title` makes the title of each of its path."""
    own = {table: list(found) for table, found in groupby(keys(root), lambda setting: setting.table)}
    if "" in own:
        yield from _rows(own[""])
    shown: dict[type[BaseModel], str] = {}
    for path, model, text in _models(root):
        name = f"`{title(path)}`"
        first, _, more = inspect.cleandoc(model.__doc__ or "").partition("\n\n")
        if not text and path in own and not own[path]:
            continue
        about = " ".join((text or first).split()) if model not in shown else text
        known = f" The keys are those of {shown[model]}." if model in shown else ""
        yield f"**{name}** {' '.join([about, *([] if known else more.split())])}{known}".rstrip() + "\n"
        if model not in shown and path in own:
            yield from _rows(own[path])
        shown.setdefault(model, name)


def documents() -> str:
    """Return the page of the keys of all files."""
    lines = [DOCUMENTS_HEAD]
    for title, root in DOCUMENTS.items():
        lines += [f"## {title}\n", f"{' '.join((root.__doc__ or '').split())}\n", *_document(root, str)]
    return HEAD + "\n".join(lines).rstrip() + "\n"


def _toml(path: str) -> str:
    """Return the head of a table in TOML."""
    return f"[[{path.removesuffix('[]')}]]" if path.endswith("[]") else f"[{path}]"


def scenario() -> str:
    """Return the page of the keys of a scenario."""
    return HEAD + "\n".join([SCENARIO_HEAD, *_document(Scenario, _toml)]).rstrip() + "\n"


def _doc(path: Path) -> str:
    """Return the first sentence of a module's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split()).removesuffix(".")


def modules() -> str:
    """Return the page of all modules, in the order of the imports where contracts state it."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = {c["containers"][0]: c["layers"] for c in contracts if c["type"] == "layers"}
    lines = [MODULES_HEAD]

    def ordered(folder: Path) -> list[Path]:
        stated = layers.get(".".join(folder.relative_to(ROOT).parts), [])
        level = {name.strip(): k for k, layer in enumerate(reversed(stated)) for name in layer.split("|")}
        inside = [
            p for p in folder.iterdir() if (p.suffix == ".py" and p.stem != "__init__") or (p / "__init__.py").exists()
        ]
        return sorted(inside, key=lambda p: (level.get(p.stem, len(level)), p.name))

    def rows(folder: Path, prefix: str) -> Iterator[tuple[str, ...]]:
        for path in ordered(folder):
            if path.is_dir():
                yield f"`{prefix}{path.name}/`", _doc(path / "__init__.py")
                yield from rows(path, f"{prefix}{path.name}/")
            else:
                yield f"`{prefix}{path.name}`", _doc(path)

    package = ROOT / "vaoi_station"
    top = ordered(package)
    lines += [
        "## vaoi_station\n",
        *_table(("module", "contents"), [(f"`{p.name}`", _doc(p)) for p in top if p.is_file()]),
    ]
    for folder in filter(Path.is_dir, top):
        lines += [f"## {folder.name}\n", _doc(folder / "__init__.py") + ".\n"]
        lines += _table(("module", "contents"), rows(folder, ""))
    return HEAD + "\n".join(lines).rstrip() + "\n"


def metrics_page() -> str:
    """Return the page of all metrics: those of an example with every optional part."""
    document = json.loads(OPENAPI.read_text(encoding="utf-8"))
    answer = document["paths"]["/api/v1/station"]["get"]["responses"]["200"]["content"]["application/json"]
    now: Any = json.loads(json.dumps(answer["example"]), object_hook=lambda members: SimpleNamespace(**members))
    now.cameras[0].temperature_c = 40.0
    now.retention.archive = SimpleNamespace(problem="", waiting=0, added=0, dropped=0, refused=0)
    state = SimpleNamespace(delivered=0, failures=0, skipped=0)
    publisher: Any = SimpleNamespace(name="mqtt", is_failing=False, waiting=0, state=state)
    storage, runs = StorageFigures(0, 0, 0, ""), RunFigures(verdicts={"ok": 1}, frames={"ok": 1})
    found: dict[str, list[str]] = {}
    for line in metrics(now, runs, [publisher], storage):
        match line.split(" ", 3):
            case ["#", "HELP", name, text]:
                found[name] = [text, "", ""]
            case ["#", "TYPE", name, kind]:
                found[name][1] = kind
            case _:
                name = re.sub(r"_(bucket|sum|count)$", "", re.split(r"[{ ]", line)[0])
                name = name if name in found else re.split(r"[{ ]", line)[0]
                labels = re.findall(r'(\w+)="', line.rpartition(" ")[0])
                found[name][2] = found[name][2] or ", ".join(f"`{label}`" for label in labels)
    rows = ((f"`{name}`", kind, labels, text) for name, (text, kind, labels) in found.items())
    return HEAD + "\n".join([METRICS_HEAD, *_table(("metric", "type", "labels", "meaning"), rows)]).rstrip() + "\n"


def tables() -> str:
    """Return the page of the tables that `vaoi restitch` writes."""
    lines = [TABLES_HEAD]
    shared = [column.name for column in KEY]
    lines += _table(("column of every table", "kind", "meaning"), KEY)
    for name, columns in TABLES.items():
        lines += [f"## {name}\n"]
        lines += _table(("column", "kind", "meaning"), (column for column in columns if column.name not in shared))
    return HEAD + "\n".join(lines).rstrip() + "\n"


def codes() -> str:
    """Return the page of all codes."""
    lines = [CODES_HEAD]
    for section in code_sections():
        lines += [f"## {section.title}\n", f"{section.about}\n"]
        named = ((", ".join(f"`{c}`" for c in e.codes), e.meaning, e.action) for e in section.codes)
        lines += _table(("code", "meaning", "what to do"), named)
    return HEAD + "\n".join(lines).rstrip() + "\n"


def pages() -> dict[Path, str]:
    """Return every generated page by its path."""
    made = {
        "reference/addresses": addresses,
        "reference/commands": commands,
        "reference/documents": documents,
        "reference/metrics": metrics_page,
        "reference/modules": modules,
        "reference/scenario": scenario,
        "reference/settings": settings,
        "reference/tables": tables,
        "codes": codes,
    }
    return {DOCS / f"{name}.md": make() for name, make in made.items()}


def main() -> None:
    """Write the pages, or compare them."""
    outdated = [path for path, text in pages().items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if "--check" in sys.argv:
        sys.exit("".join(f"{path.relative_to(ROOT)} is outdated: python docs/generate.py\n" for path in outdated))
    for path in outdated:
        path.write_text(pages()[path], encoding="utf-8")


if __name__ == "__main__":
    main()
