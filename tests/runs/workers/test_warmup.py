"""The warm-up stitches a board completely, and two processes compile at the first start."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.model import Stitch
from vaoi_station.runs.workers.second_compiler import ORPHANED
from vaoi_station.runs.workers.warmup import warm_up
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture(scope="module")
def stitch() -> Stitch:
    return warm_up()


PROGRAM = """
from vaoi_station.runs.workers import worker
from vaoi_station.runs.workers.warmup import warm_up
from vaoi_station import compiled
warm_up()
left = {f"{made.py_func.__module__}.{made.py_func.__name__}" for made in compiled._functions if not made.signatures}
print(*sorted(left))
"""
INSIDE = {
    "vaoi_station.frame_index._relation",
    "vaoi_station.frame_index._share_of_union",
}
"""Functions that only compiled functions call: when these are loaded, the code of the others is part of theirs."""


def test_nothing_is_left_to_compile_at_the_first_board() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True)
    assert {*done.stdout.split()} <= INSIDE


PICTURES = """
import sys
from pathlib import Path
from typer.testing import CliRunner
from vaoi_station import compiled
from vaoi_station.cli import app
from vaoi_station.runs.workers.warmup import warm_up

run, result, out = sys.argv[1:]
warm_up()
known = compiled.signatures()
for command in ("cut --all", "cut --all --hdr", "mosaic", "mosaic --hdr", "heights", "identify"):
    target = [] if command == "identify" else ["--out", f"{out}/{command}.tif"]
    done = CliRunner().invoke(app, [*command.split(), run, "--result", result, *target])
    assert done.exit_code in (0, 1), done.output
print(*(f"{name} {types}" for name, types in sorted(compiled.signatures() - known)), sep="\\n")
"""
"""Makes all kinds of pictures of a run; prints what was compiled, or loaded, that the warm-up does not need."""


@pytest.fixture(scope="module")
def distorted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run under changing light, of cameras whose lenses bend lines too much for one matrix per picture."""
    folder = tmp_path_factory.mktemp("distorted")
    scenario = folder / "scenario.toml"
    text = scenario_path("light").read_text()
    scenario.write_text(text.replace("[array]", "[array]\ndistortion_px = 3.0", 1))
    write_passage(Twin(read_scenario(scenario)).passage(0), folder / "run")
    return folder / "run"


def test_no_picture_of_a_board_waits_for_the_compiler(distorted: Path, tmp_path: Path) -> None:
    """A merged picture whose code was compiled in its job took longer than a job may on a busy machine."""
    result = tmp_path / "result.json"
    stitched = CliRunner().invoke(app, ["stitch", str(distorted), "--out", str(result)])
    assert stitched.exit_code == 0, stitched.output
    command = [sys.executable, "-c", PICTURES, str(distorted), str(result), str(tmp_path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


SAME_CODE = """
from vaoi_station import compiled
from vaoi_station.runs.workers import worker
from vaoi_station.runs.workers.warmup import warm_up, warm_up_from_the_end

warm_up_from_the_end()
second = compiled.signatures()
warm_up()
first = compiled.signatures()
warm_up_from_the_end()
print(len(second), len(first), *(compiled.signatures() - first))
"""
"""Prints how many functions the second process compiles, how many the first needs, and what is compiled in vain."""

STARTED = """
import os
from pathlib import Path
from vaoi_station.compiled import compiled
from vaoi_station.runs.workers.second_compiler import second_compiler

def children():
    return len(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())

@compiled
def half(x):
    return x / 2

os.sched_getaffinity = lambda pid: set(range(CORES))
with second_compiler():
    before = children()
    assert half(2.0) == 1.0
    meanwhile = children()
    assert half(2) == 1.0
    again = children()
print(before, meanwhile, again, children())
"""
"""Prints the number of child processes before, while and after this process compiles, and after the context."""


def test_the_second_process_compiles_what_the_first_one_needs_and_nothing_else() -> None:
    done = subprocess.run([sys.executable, "-c", SAME_CODE], check=True, capture_output=True, text=True)
    second, first, *in_vain = done.stdout.split()
    assert in_vain == []
    assert 0 < int(second) < int(first)


def started(folder: Path, cores: int) -> str:
    source = folder / "started.py"
    source.write_text(STARTED.replace("CORES", str(cores)))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, source], env=environment, check=True, capture_output=True, text=True
    ).stdout.strip()


def test_the_second_process_is_started_when_the_first_one_compiles_and_ends_with_the_context(tmp_path: Path) -> None:
    assert started(tmp_path, cores=2) == "0 1 1 0"
    assert started(tmp_path, cores=2) == "0 0 0 0", "all machine code is in the cache"


def test_a_process_with_one_core_compiles_alone(tmp_path: Path) -> None:
    assert started(tmp_path, cores=1) == "0 0 0 0"


def test_the_second_process_ends_with_the_first(tmp_path: Path) -> None:
    """With an empty cache it would compile for longer than this test takes."""
    process = subprocess.Popen(
        [sys.executable, "-m", "vaoi_station.runs.workers.second_compiler"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        stdin=subprocess.PIPE,
    )
    process.communicate()
    assert process.returncode == ORPHANED
