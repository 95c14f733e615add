"""Run one stitcher over the strips, in a separate environment: `python -m peers.place NAME STRIPS OUT.jsonl`.

Only the placement is timed: not imports, reading, conversion or blending. CPU time includes all threads and child
processes. Each setting is repeated until it has run `REPEATS` times or used `CPU_LIMIT_S`, and the fastest run counts,
because the first call of a library compiles, plans and caches. The error of a stitcher that fails is its result.
"""

from __future__ import annotations

import importlib
import json
import platform
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from .adapter import Adapter
from .strip import STRIPS, Matrices, Strip

REPEATS = 3
CPU_LIMIT_S = 15.0


def run(adapter: Adapter, strips: list[Path]) -> Iterator[dict[str, Any]]:
    """Yield the results of all settings on all strips."""
    for directory in strips:
        strip = Strip.read(directory)
        prepared = adapter.prepare(strip, directory)
        for name, setting in adapter.SETTINGS.items():
            if not setting.strips or strip.name in setting.strips:
                done = _timed(partial(adapter.place, prepared, **setting.options))
                yield {"strip": strip.name, "setting": name, "as_it_is": setting.as_it_is} | done


def _timed(work: Callable[[], Matrices]) -> dict[str, Any]:
    times: list[tuple[float, float]] = []
    while not times or (len(times) < REPEATS and sum(cpu for cpu, _ in times) < CPU_LIMIT_S):
        cpu, wall = _cpu_s(), time.perf_counter()
        try:
            matrices = work()
        except Exception as error:  # noqa: BLE001 - any exception of a peer is its result
            traceback.print_exc()
            return {"failure": f"{type(error).__name__}: {error}"}
        times.append((_cpu_s() - cpu, time.perf_counter() - wall))
    return {
        "cpu_s": min(cpu for cpu, _ in times),
        "wall_s": min(wall for _, wall in times),
        "repeats": len(times),
        "matrices": [None if m is None else m.tolist() for m in matrices],
    }


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def this_machine() -> str:
    """Return processor, number of cores and Python version of this machine."""
    info = Path("/proc/cpuinfo")
    models = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {len(models)} cores, Python {platform.python_version()}"


def main() -> None:
    """Run the named stitcher on all strips of a directory; write one line of JSON per run."""
    name, strips, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    warnings.simplefilter("ignore")  # peers use deprecated names of their dependencies
    adapter = cast("Adapter", importlib.import_module(f"{__package__}.adapters.{name}"))
    found = [strips / strip for strip in STRIPS]
    versions = {package: version(package) for package in adapter.PACKAGES}
    heading = {"name": name, "versions": versions, "machine": this_machine()}
    with out.open("w") as lines:
        for done in run(adapter, found):
            lines.write(json.dumps(heading | done) + "\n")
            lines.flush()
            print(name, done["strip"], done["setting"], done.get("failure", done.get("cpu_s")), flush=True)


if __name__ == "__main__":
    main()
