"""Rules of the source tree: small folders, short parameter lists, mirrored tests, plain words (docs/conventions.md)."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
MOST_FILES, MOST_LINES, MOST_PARAMETERS = 15, 400, 8
LEAST_COMMENTS = 20
"""Comments on lines of their own, per 1000 lines of code."""
LEAST_CODE = 12
"""Modules with fewer lines of code need no test of their own."""
FOLDERS = ("vaoi_station", "tests", "hw", "docs", "deploy")
WRITTEN = {".py", ".md", ".c", ".h", ".js", ".html", ".css", ".toml"}
FOREIGN = {"vendor", "__pycache__", "build"}


@cache
def files() -> tuple[Path, ...]:
    """Every file that people wrote, relative to the root."""
    found = (path.relative_to(ROOT) for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*")))
    return tuple(p for p in found if not FOREIGN & set(p.parts) and (ROOT / p).is_file())


def modules(folder: str = "") -> Iterator[Path]:
    return (p for p in files() if p.suffix == ".py" and p.parts[0].startswith(folder))


class Summary(NamedTuple):
    """What the rules need of one module; its syntax tree is read once."""

    lines: int
    code: int
    comments: int
    """Comments on lines of their own."""
    crowded: tuple[str, ...]
    """Functions with more than `MOST_PARAMETERS`."""


@cache
def summary(path: Path) -> Summary:
    text = (ROOT / path).read_text(encoding="utf-8")
    documented, crowded = set[int](), []
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(value=ast.Constant(value=str()) as words):  # docstrings, those below attributes included
                documented.update(range(words.lineno, (words.end_lineno or words.lineno) + 1))
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len(names) - (names[:1] in (["self"], ["cls"])) > MOST_PARAMETERS:
                    crowded.append(f"{path}:{node.lineno} {node.name}")
    lines = text.splitlines()
    rest = [line.strip() for n, line in enumerate(lines, 1) if n not in documented]
    comments = sum(line.startswith("#") for line in rest)
    return Summary(len(lines), sum(bool(line) for line in rest) - comments, comments, tuple(crowded))


def test_no_folder_has_more_than_fifteen_files() -> None:
    counts = Counter(p.parent for p in files() if p.name != "__init__.py")
    crowded = {str(folder): n for folder, n in counts.items() if n > MOST_FILES}
    assert not crowded, "give each idea a folder of its own"


def test_no_module_is_too_long() -> None:
    assert not {str(p): summary(p).lines for p in modules() if summary(p).lines > MOST_LINES}, "split it by idea"


def test_no_function_takes_too_many_parameters() -> None:
    bound = (p for p in modules() if not {"cli", "routes"} & set(p.parts))  # theirs are options and query fields
    found = [function for path in bound for function in summary(path).crowded]
    assert not found, "group what belongs together in a NamedTuple or a dataclass"


def test_every_module_has_its_test_at_the_same_place() -> None:
    missing = []
    for path in modules("vaoi_station"):
        test = Path("tests", *path.parts[1:-1], f"test_{path.name}")
        if path.name != "__init__.py" and summary(path).code >= LEAST_CODE and not (ROOT / test).is_file():
            missing.append(f"{path}: no {test}")
    assert not missing


def test_comments_say_why_often_enough() -> None:
    read = [summary(path) for path in modules("vaoi_station")]
    assert 1000 * sum(s.comments for s in read) / sum(s.code for s in read) >= LEAST_COMMENTS


def test_there_is_enough_test_code() -> None:
    source, tests = (sum(summary(p).code for p in modules(folder)) for folder in ("vaoi_station", "tests"))
    assert tests / source >= 0.9


def unwanted() -> re.Pattern[str]:
    """The words in the last table of the glossary."""
    table = GLOSSARY.read_text(encoding="utf-8").split("## Words not used")[1]
    cells = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")][2:]
    words = [word.strip() for cell in cells for word in cell.split(",")]
    return re.compile(rf"\b({'|'.join(map(re.escape, words))})\b", re.IGNORECASE)


@pytest.mark.parametrize("folder", FOLDERS)
def test_words_of_the_glossary_are_used(folder: str) -> None:
    pattern, found = unwanted(), []
    assert pattern.search("the waiter is told when"), "the table is read"
    for path in files():
        if path.parts[0] != folder or path.suffix not in WRITTEN or ROOT / path == GLOSSARY:
            continue
        if path == Path(__file__).relative_to(ROOT):
            continue
        for number, line in enumerate((ROOT / path).read_text(encoding="utf-8").splitlines(), 1):
            # Lettering that the twin paints is in capitals; another text would be another picture.
            found += [f"{path}:{number}: {m[0]!r}" for m in pattern.finditer(line) if not m[0].isupper()]
    assert not found, f"docs/glossary.md names the word to use instead ({len(found)} places)"


def test_no_thread_of_the_station_has_a_lower_priority() -> None:
    """While such a thread holds the GIL, it waits for a core behind all workers, and with it every other thread."""
    processes = {
        "vaoi_station/rig/devices/processes.py": "the processes of emulated devices",
        "vaoi_station/runs/handover/adder.py": "the process that adds runs to the archive of the plant",
    }
    found = {str(path) for path in modules("vaoi_station") if "os.setpriority(" in (ROOT / path).read_text("utf-8")}
    assert found == set(processes), "only a process of its own may have one"


def test_threads_of_the_service_are_supervised() -> None:
    """A thread that serves until the station stops must not end or hang unnoticed."""
    short_lived = {
        "vaoi_station/acquisition/cameras/aravis/connection.py": "releases one device; opening it again is limited",
        "vaoi_station/acquisition/process/main_loop.py": "closes devices; its end is awaited for END_S",
        "vaoi_station/runs/pictures/small_pictures.py": "loads compiled functions; workers render meanwhile",
        "vaoi_station/runs/workers/forking/second_compiler.py": "ends a process of the first start with its parent",
        "vaoi_station/station.py": "writes the event of a lost thread; its end is awaited for REPORT_S",
    }
    other_programs = {"benchmarks", "demo", "plant", "rig"}
    found = {
        str(path)
        for path in modules("vaoi_station")
        if path.parts[1] not in other_programs
        and re.search(r"\bthreading\.Thread\((?!\))", (ROOT / path).read_text(encoding="utf-8"))
    }
    assert found == set(short_lived), "use SupervisedThread, and let the supervisor watch it"
