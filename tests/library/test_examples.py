"""Every program of docs/examples runs as it stands."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def run_example(name: str, *arguments: str | Path) -> str:
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_probe_coordinates(recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, tmp_path: Path) -> None:
    stitched.save(tmp_path / "result.json")
    lines = run_example("probe_coordinates.py", recording.directory, tmp_path / "result.json").splitlines()
    assert [line.split()[0] for line in lines] == list(stitched.refs)


def test_reproject_a_point(tmp_path: Path) -> None:
    shown = run_example("reproject_a_point.py", tmp_path)
    worst = float(shown.split(": ")[1].split(" px")[0])
    assert 0 < worst < 0.3


def test_images_from_a_station(tmp_path: Path) -> None:
    station = HeldStation()
    station.film()
    served = Served(station)
    try:
        run_example("images_from_a_station.py", served.url, "U1", tmp_path)
    finally:
        served.stop()
    assert list(tmp_path.glob("U1_*.png"))


def test_probe_a_clamped_board() -> None:
    station = HeldStation()
    station.film()
    served = Served(station)
    try:
        lines = run_example("probe_a_clamped_board.py", served.url).splitlines()
    finally:
        served.stop()
    places = {line.split()[0]: line.split() for line in lines if " x " in line}
    # A turn by 30° about the origin, then a shift by (400, 250): U1 is at (20, 20).
    assert float(places["U1"][2]) == pytest.approx(400 + 20 * 0.866025 - 20 * 0.5, abs=2e-2)
    assert "R1" in places
    assert any(line.startswith("keep out U1: unknown height") for line in lines)


def test_pictures_of_every_board() -> None:
    served = Served(HeldStation())

    def pass_by() -> None:
        while served.app.state.hub.waiting == 0:
            served.client.get("/healthz")
        served.station.film()

    try:
        with ThreadPoolExecutor(1) as line:
            passing = line.submit(pass_by)
            shown = run_example("pictures_of_every_board.py", served.url, "demo-board", "1")
            passing.result()
    finally:
        served.stop()
    assert shown == "run r000001: ok, 9 pictures\n"


def test_the_table_lists_every_example() -> None:
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    missing = [path.name for path in EXAMPLES.glob("*.py") if f"({path.name})" not in table]
    assert not missing


@pytest.mark.parametrize("name", [path.name for path in EXAMPLES.glob("*.py")])
def test_an_example_uses_public_names_only(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    assert "from vaoi_station" not in text
    assert "import vaoi_station as vaoi" in text or name in {"best_image.py", "tester.py"}, "two need no package"
