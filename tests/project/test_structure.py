"""Rules of the source tree: short parameter lists, supervised threads (docs/conventions.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from vaoi_station.supervised_thread import URGENT_NICE

ROOT = Path(__file__).resolve().parents[2]
MOST_PARAMETERS = 8
FOLDERS = ("vaoi_station", "tests", "hw", "docs", "deploy")
FOREIGN = {"vendor", "__pycache__", "build"}


@cache
def modules(folder: str = "") -> tuple[Path, ...]:
    """Every module that people wrote, relative to the root."""
    found = (path.relative_to(ROOT) for top in FOLDERS for path in sorted((ROOT / top).rglob("*.py")))
    return tuple(path for path in found if not FOREIGN & set(path.parts) and path.parts[0].startswith(folder))


def crowded(path: Path) -> Iterator[str]:
    """Yield the functions of a module with more than `MOST_PARAMETERS`."""
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            if len(names) - (names[:1] in (["self"], ["cls"])) > MOST_PARAMETERS:
                yield f"{path}:{node.lineno} {node.name}"


def test_no_function_takes_too_many_parameters() -> None:
    bound = (p for p in modules() if not {"cli", "routes"} & set(p.parts))  # theirs are options and query fields
    found = [function for path in bound for function in crowded(path)]
    assert not found, "group what belongs together in a NamedTuple or a dataclass"


def test_no_thread_of_the_station_has_a_lower_priority() -> None:
    """While such a thread holds the GIL, it waits for a core behind all workers, and with it every other thread."""
    processes = {
        "vaoi_station/rig/device_process.py": "the processes of emulated devices",
        "vaoi_station/runs/handover/adder.py": "the process that adds runs to the archive of the plant",
        "vaoi_station/supervised_thread.py": "urgent threads, which have a higher one",
    }
    found = {str(path) for path in modules("vaoi_station") if "os.setpriority(" in (ROOT / path).read_text("utf-8")}
    assert found == set(processes), "only a process of its own may have one"
    assert URGENT_NICE < 0


def test_threads_of_the_service_are_supervised() -> None:
    """A thread that serves until the station stops must not end or hang unnoticed."""
    short_lived = {
        "vaoi_station/acquisition/cameras/aravis/connection.py": "releases one device; opening it again is limited",
        "vaoi_station/acquisition/process/main_loop.py": "closes devices; its end is awaited for END_S",
        "vaoi_station/runs/workers/second_compiler.py": "ends a process of the first start with its parent",
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
