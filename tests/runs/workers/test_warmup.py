"""The warm-up calls everything that is compiled, and first what the first pictures of a board need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage

PROGRAM = """
from vaoi_station.runs.workers import worker
from vaoi_station.runs.workers.warmup import warm_up, warm_up_later
from vaoi_station import compiled
warm_up()
warm_up_later()
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
from vaoi_station.runs.workers.warmup import warm_up, warm_up_later

run, result, out = sys.argv[1:]
warm_up()
warm_up_later()
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
