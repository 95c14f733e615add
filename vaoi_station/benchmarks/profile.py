"""Show where the CPU time of stitching goes: by kind of task, by stage of the conclusion, and by function.

`prepare` is what workers do of the conclusion while the board passes; the conclusion ends with matrices and verdict.

Times of kinds and stages are measured without the profiler, which makes small functions look slower than they are.
"""

from __future__ import annotations

import cProfile
import json
import pstats
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_twin, cpu_ms, one_thread
from vaoi_station.benchmarks.speed import prepare, stitch_board
from vaoi_station.benchmarks.tables import number, table
from vaoi_station.child_environment import child_environment
from vaoi_station.stitching.work import TaskRunner, all_tasks

_PACKAGE = Path(__file__).parents[1]
_FUNCTIONS = 12
"""Number of functions that are shown for each kind of task, and for the conclusion."""


_PROGRAM = "from vaoi_station.benchmarks import profile; profile.print_compiling({scenario!r})"
"""Program of the process that compiles everything anew."""


@dataclass(frozen=True)
class Profile:
    """CPU times of one board in one thread, ms; those of kinds and of their functions are per frame."""

    material: str
    frames: int
    kinds_ms: dict[str, float]
    conclusion_ms: float
    stages_ms: dict[str, float]
    """Time of each stage of the conclusion, by the clock."""
    functions: dict[str, list[tuple[str, float, float, float]]]
    """The functions that take longest, by kind of task and for the conclusion: calls, time with and without what they
    call."""

    def text(self) -> str:
        """Return all figures as Markdown tables."""
        kinds = [(f"{kind}, per frame", number(ms, 3)) for kind, ms in self.kinds_ms.items()]
        kinds += [("all tasks, per frame", number(sum(self.kinds_ms.values()), 3))]
        kinds += [("conclusion", number(self.conclusion_ms, 1))]
        stages = [(stage, number(ms, 1)) for stage, ms in self.stages_ms.items()]
        parts = [table((f"{self.material}, {self.frames} frames", "CPU ms"), kinds)]
        parts += [table(("stage of the conclusion", "ms by the clock"), stages)]
        for part, functions in self.functions.items():
            rows = [(name, *map(number, figures, (2, 3, 3))) for name, *figures in functions]
            parts.append(table((part, "calls", "ms", "own ms"), rows))
        return "\n\n".join(parts)


@one_thread()
def measure_profile(board: BenchmarkBoard, repetitions: int = 5) -> Profile:
    """Measure the tasks and the conclusion of one board, first without, then with a profiler."""
    times_s = board.head.row_times_s()
    present = sorted(board.frames, key=lambda key: (key[1], key[0]))
    tasks, frames = all_tasks(present, dict(enumerate(times_s)), board.setup), len(present)
    stitch_board(board)  # compiles
    kinds, stages, conclusions = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list), []
    for _ in range(repetitions):
        runner, evidence, taken = TaskRunner(board.setup, board.frame), [], defaultdict[str, float](float)
        for task in tasks:
            taken[task.kind] += cpu_ms(lambda: evidence.append(runner.perform(task)))  # noqa: B023  (called at once)
            runner.add_evidence(evidence[-1])
            taken["prepare"] += cpu_ms(lambda: prepare(runner))  # noqa: B023
        for kind, ms in taken.items():
            kinds[kind].append(ms / frames)
        found: list[Any] = []
        conclusions.append(cpu_ms(lambda: found.append(runner.answer(times_s, present, evidence)[0])))  # noqa: B023
        for stage, ms in found[0].quality["timings_ms"].items():
            stages[stage].append(ms)
    profiles = defaultdict[str, cProfile.Profile](_profiler)
    runner = TaskRunner(board.setup, board.frame)
    evidence = []
    for task in tasks:
        evidence.append(profiles[task.kind].runcall(runner.perform, task))
        runner.add_evidence(evidence[-1])
        profiles["prepare"].runcall(prepare, runner)
    conclusion = _profiler()
    conclusion.runcall(runner.answer, times_s, present, evidence)
    functions = {f"{kind}, per frame": _longest(profile, frames) for kind, profile in profiles.items()}
    functions["conclusion"] = _longest(conclusion, 1)
    median = statistics.median
    return Profile(
        board.name,
        frames,
        {kind: round(median(values), 3) for kind, values in kinds.items()},
        round(median(conclusions), 1),
        {stage: round(median(values), 1) for stage, values in stages.items()},
        functions,
    )


def _profiler() -> cProfile.Profile:
    return cProfile.Profile(time.process_time)


def _longest(profile: cProfile.Profile, divisor: int) -> list[tuple[str, float, float, float]]:
    """Return the functions of the package with the longest times in a profile, per `divisor`."""
    found = []
    statistic: dict[tuple[str, int, str], tuple[int, int, float, float, Any]] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    for (file, _, name), (_, calls, own_s, s, _) in statistic.items():
        if Path(file).is_relative_to(_PACKAGE):
            module = Path(file).relative_to(_PACKAGE).with_suffix("").as_posix()
            ms, own_ms = (round(value * 1e3 / divisor, 4) for value in (s, own_s))
            found.append((f"{module}: {name}", round(calls / divisor, 3), ms, own_ms))
    return sorted(found, key=itemgetter(2), reverse=True)[:_FUNCTIONS]


def measure_compiling(scenario: str = "small") -> list[tuple[str, int, float]]:
    """Stitch a board of the twin in a new process with an empty cache of machine code.

    Returns module and name of each compiled function, how many combinations of argument types were compiled, and the
    seconds for them, without those of functions that were compiled meanwhile; the longest first.
    """
    with tempfile.TemporaryDirectory(prefix="vaoi-bench-") as cache:
        child = subprocess.run(
            [sys.executable, "-c", _PROGRAM.format(scenario=scenario)],
            env=child_environment(NUMBA_CACHE_DIR=cache),
            stdout=-1,
            check=True,
        )
    return [(name, count, s) for name, count, s in json.loads(child.stdout)]


def print_compiling(scenario: str) -> None:
    """Print as JSON what `measure_compiling` returns, for this process."""
    from numba.core import event

    spent, counts, running = defaultdict[str, float](float), defaultdict[str, int](int), [("", 0.0)]

    class Times(event.Listener):
        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            name = f"{function.__module__.removeprefix('vaoi_station.')}: {function.__name__}"
            counts[name] += 1
            self.passed(time.process_time())
            running.append((name, time.process_time()))

        def on_end(self, event: Any) -> None:  # noqa: ARG002  (the signature of a listener)
            self.passed(time.process_time())
            running.pop()

        def passed(self, now: float) -> None:
            """Add the time since the last event to the function that was compiled meanwhile."""
            spent[running[-1][0]] += now - running[0][1]
            running[0] = "", now

    event.register("numba:compile", Times())  # type: ignore[no-untyped-call]
    stitch_board(board_from_twin(scenario))
    del spent[""]
    print(json.dumps(sorted(((n, counts[n], round(s, 3)) for n, s in spent.items()), key=itemgetter(2), reverse=True)))  # noqa: T201


def compiling_table(figures: list[tuple[str, int, float]]) -> str:
    """Return what `measure_compiling` found as a Markdown table."""
    total = ("all", sum(count for _, count, _ in figures), sum(s for _, _, s in figures))
    return table(("compiled function", "variants", "CPU s"), [(n, c, number(s, 2)) for n, c, s in (*figures, total)])
