"""`vaoi demo` as a separate program: the whole service on the twin; nothing remains afterwards."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from tests.clients import compiled_csharp, guide_sample, run_csharp
from tests.needs import need
from tests.processes import ends_within
from vaoi_station.demo.client import Client
from vaoi_station.demo.report import DemoReport

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 120.0
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts `vaoi demo …` with a separate temporary directory."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "vaoi_station", "demo", *arguments],
            cwd=ROOT,
            env=os.environ | {"TMPDIR": str(temporary)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()
        assert not list(Path("/dev/shm").glob(f"vaoi-demo-{process.pid}*"))


def test_one_board_from_the_barrier_to_the_contact_sheet(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start("--scenario", "small", "--once", "--json", "--out", str(out))
    output, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, errors
    stages = errors.splitlines()
    assert len(stages) == 5
    assert all(re.fullmatch(r" *[0-9.]+ s  .+", stage) for stage in stages), errors
    report = DemoReport.model_validate_json(output)
    assert report.ok
    run = report.run
    assert (run["verdict"], run["reasons"]) == ("ok", [])
    assert (run["counts"]["ok"], run["counts"]["missing"]) == (run["cameras"] * run["rows"], 0)
    assert report.deviation.rms_px < 0.2
    assert report.deviation.max_px < 0.6
    assert math.hypot(*run["belt"]["measured_mm_s"]) == pytest.approx(report.true_mm_s, abs=0.3)
    assert run["timings"]["links_while_filming"] > 0
    assert json.loads((out / "report.json").read_text()) == json.loads(output)
    assert json.loads((out / "matrices.json").read_text())["format"] == "vaoi-stitch"
    check_pictures(report, out)
    assert list((tmp_path / "tmp").iterdir()) == []


def check_pictures(report: DemoReport, out: Path) -> None:
    """Check that each component has pictures, and that the list gives their size."""
    folders = sorted((out / "components").iterdir())
    assert len(folders) == report.components
    files = list((out / "components").glob("*/*.png"))
    assert len(files) == report.pictures
    for folder in folders:
        views = json.loads((folder / "views.json").read_text())
        assert views, f"{folder.name} is in no picture"
        best = cv2.imread(str(next(folder.glob("00_*.png"))), cv2.IMREAD_UNCHANGED)
        assert best is not None
        assert best.shape == (views[0]["height_px"], views[0]["width_px"])
    sheet = cv2.imread(str(out / "contact-sheet.png"))
    assert sheet is not None
    assert sheet.shape[1] > 1000


def check_end(process: subprocess.Popen[str], processes: list[int], tmp_path: Path) -> None:
    """Check that a demo ends in order after a signal: without an error, a process or a file that remains."""
    output, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, errors) == (0, ""), output
    assert not [pid for pid in processes if Path(f"/proc/{pid}").exists()]
    assert list((tmp_path / "tmp").iterdir()) == []


def test_service_ends_when_its_demo_is_killed(start: Start) -> None:
    process = start("--scenario", "small", "--port", "0")
    _, processes = until_board(process, 1)
    process.kill()
    process.communicate()
    for pid in processes:
        assert ends_within(pid, TIMEOUT_S), f"process {pid} outlived its demo"


def search_of_the_administrator(address: str) -> str:
    """Return the search of the administrator's guide for a run, around the present time in place of yesterday."""
    text = (ROOT / "docs" / "administrator.md").read_text(encoding="utf-8")
    [found] = re.findall(r"^```sh\n(api=.*?)^vaoi export RUN", text, re.MULTILINE | re.DOTALL)
    for printed, now in (
        ("http://127.0.0.1:8350", address),
        ("yesterday 13:55", "-1 hour"),
        ("yesterday 14:05", "1 hour"),
    ):
        assert printed in found
        found = found.replace(printed, now)
    return str(found)


def test_the_guide_runs_as_printed_against_the_demo_while_boards_come(start: Start, tmp_path: Path) -> None:
    """In every language, with the board type and the component that the guide names; then SIGTERM ends the demo."""
    need("curl", "cc", "curl/curl.h")
    program = compiled_csharp(tmp_path)
    process = start("--port", "0")
    address, processes = until_board(process, 1, "demo")
    client = Client(address)

    def run(*command: str) -> str:
        environment = os.environ | {"VAOI_STATION": address}
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("sh", "-eu", "-c", guide_sample("sh"))
    for name in ("U1.png", "U1.jpg"):
        assert cv2.imread(str(tmp_path / name)) is not None
    (tmp_path / "tester.py").write_text(guide_sample("python"), encoding="utf-8")
    said = run(sys.executable, "tester.py", "demo", "U1")
    assert re.search(r"^run \S+: ok\n  camera \d row \d+: \d+ x \d+, mean ", said)
    made = client.get("/runs/latest")
    searched = run("sh", "-eu", "-c", search_of_the_administrator(address).replace("RUN", made["id"]))
    assert f'"id":"{made["id"]}"' in searched
    assert f"'calibration': '{made['calibration']}', 'made_with': {{'configuration': " in searched
    done = run_csharp(program, address, "demo", "U1")
    assert done.returncode == 0, done.stderr
    assert re.match(r"run \S+: ok\n  C: scale 1.00\n  camera \d row \d+: \d+ x \d+, grey level \d+ in", done.stdout)
    pictures, components = map(int, re.findall(r"best pictures: (\d+) of (\d+) components", done.stdout)[0])
    assert pictures == components == len(client.get("/board-types/demo")["components"])
    assert cv2.imread(str(tmp_path / "0.png")) is not None
    (tmp_path / "tester.c").write_text(guide_sample("c"), encoding="utf-8")
    run("cc", "-Wall", "-Wextra", "-Werror", "tester.c", "-o", "tester", "-lcurl")
    client.post("/station/arm", board_type="demo", runs=1)  # no later board takes its memory
    board = client.get("/runs/next", timeout=60)["id"]
    assert re.fullmatch(r"\d+ x \d+, \d+ bytes per line, \d+ bytes\n", run("./tester", board, "U1"))
    process.terminate()
    check_end(process, processes, tmp_path)


def until_board(process: subprocess.Popen[str], count: int, board_type: str = "small") -> tuple[str, list[int]]:
    """Wait until `count` boards are reported; return the service's address and the ids of its processes."""
    assert process.stdout is not None
    address = ""
    for line in process.stdout:
        if found := re.search(r"page: (http://\S+)/", line):
            address = found[1]
        if line.startswith(f"board {count}: ok"):
            station: dict[str, Any] = Client(address).get("/station")
            assert station["armed_with"]["board_type"] == board_type
            children = [p["pid"] for p in station["processes"]]
            return address, [parent_of(children[0]), *children]
    raise AssertionError(process.stderr.read() if process.stderr else "")


def parent_of(pid: int) -> int:
    """Return the id of the parent process."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
