"""The real backends on the virtual rig: firmware on an emulated chip, GigE Vision on loopback, REST.

`vaoi rig run` runs as a program: it restarts itself in a new network namespace and starts `vaoi serve` there.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.needs import DESCRIPTIONS, need_aravis, need_descriptions, need_emulator
from tests.processes import ends_within
from vaoi_station.config import read_config

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = ROOT / "vaoi_station" / "simulation" / "scenarios"
pytestmark = pytest.mark.aravis


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("films")


def need_all() -> None:
    need_emulator()
    need_aravis()


def rig_run(folder: Path, films: Path, *options: str) -> tuple[int, dict[str, Any], str]:
    """Run `vaoi rig run`; return its exit code, its report and its output.

    A run without a verdict, because the rig's own cameras sent too late on a busy machine, is repeated up to twice.
    """
    need_all()
    path = folder / "report.json"
    command = [sys.executable, "-m", "vaoi_station", "rig", "run", "--films", str(films), "--json", str(path)]
    for _ in range(3):
        path.unlink(missing_ok=True)
        done = subprocess.run([*command, *options], cwd=ROOT, capture_output=True, text=True, check=False, timeout=280)
        output = done.stdout + done.stderr
        assert path.is_file(), output
        report = json.loads(path.read_text())
        if not any("too busy for a verdict" in words for words in report["failings"]):
            break
    return done.returncode, report, output


def affected(board: dict[str, Any]) -> set[tuple[int, int]]:
    return {(named["camera"], named["row"]) for named in board["affected"]}


def test_every_frame_of_three_cameras_is_in_its_proven_row(tmp_path: Path, films: Path) -> None:
    """An overlap of 32 px has no room for a patch; it must not be reported as the drift of a camera."""
    code, report, output = rig_run(tmp_path, films, "--scenario", "small", "--cameras", "3", "--boards", "1")
    assert (code, report["ok"], report["failings"]) == (0, True, []), output
    assert report["cameras"] == 3
    assert [board["status"] for board in report["boards"]] == ["ok"]
    for board in report["boards"]:
        assert board["ok"] == board["proven"] == 3 * board["rows_due"] > 0
        assert board["pulse_off_us"] < 1.0
        assert board["deviation"]["unplaced"] == 0
    assert report["rms_px"] <= 0.10
    assert (report["boards_missed"], report["stray_pulses"]) == (0, 0)
    assert "all checks passed" in output


def test_cameras_of_two_makers_film_a_board_as_the_rigs_own(tmp_path: Path, films: Path) -> None:
    """Their names, units and triggers differ: GigE Vision 1 of Basler, and SFNC 2 of FLIR."""
    need_descriptions()
    makes = [f"--description={DESCRIPTIONS / name}.xml.gz" for name in ("Basler-acA2440-20gm", "FLIR-BFS-PGE-50S4C")]
    options = ("--scenario", "small", "--boards", "1", "--workers", "1", *makes)
    code, report, output = rig_run(tmp_path, films, *options)
    assert (code, report["failings"]) == (0, []), output
    [board] = report["boards"]
    assert (board["status"], report["cameras"]) == ("ok", 2)
    assert board["ok"] == board["proven"] == 2 * board["rows_due"] > 0


def test_faults_are_reported_with_their_cause_and_affect_no_other_frame(tmp_path: Path, films: Path) -> None:
    """A camera outage, an ignored pulse, a stalled station and a reset controller, on a noisy serial line with a
    bouncing barrier."""
    code, report, output = rig_run(
        tmp_path,
        films,
        *("--scenario", "small", "--boards", "5", "--fault", "noise:share=0.001", "--fault", "bounce:board=0"),
        *("--fault", "kill:camera=1,board=1,row=3,for_s=1", "--fault", "ignored:camera=0,board=2,row=3"),
        *("--fault", "stall:who=station,board=3,row=1", "--fault", "reset:board=4,row=4"),
    )
    assert (code, report["ok"], report["failings"]) == (0, True, []), output
    boards = report["boards"]
    assert [affected(boards[k]) for k in (0, 2, 3)] == [set(), {(0, 3)}, set()]
    assert {(1, 3), (1, 4), (1, 5)} <= affected(boards[1]) <= {(1, 2), (1, 3), (1, 4), (1, 5)}
    assert all(named["cause"] for board in boards for named in board["affected"])
    assert all(board["proven"] == board["ok"] for board in boards)
    assert boards[4]["rows"] < boards[4]["rows_due"]
    assert any("the controller was reset" in words for words in boards[4]["reasons"])
    assert {r["fault"] for r in report["recoveries"]} == {"kill", "stall", "reset"}
    assert all(r["ready_after_s"] <= 12.0 for r in report["recoveries"])


def test_every_frame_of_a_light_program_is_lit_as_its_row(tmp_path: Path, films: Path) -> None:
    """Three lights in turn and a short exposure: the pins of the chip, the pixels and the statements of the station."""
    code, report, output = rig_run(tmp_path, films, "--scenario", "light", "--boards", "1", "--workers", "1")
    assert (code, report["failings"]) == (0, []), output
    [board] = report["boards"]
    assert board["status"] == "ok"
    assert board["ok"] == board["proven"] == 2 * board["rows_due"] > 0
    assert (board["wrong"], board["mislit"], board["notes"]) == ([], [], [])


def test_an_encoder_spaces_the_rows_of_a_belt_that_slows_down(tmp_path: Path, films: Path) -> None:
    """Pixels are rendered for the places that the counts give; rows by the clock would lie closer together."""
    paced = (SCENARIOS / "small.toml").read_text().replace("[line]", "[line]\nencoder_counts_per_mm = 20.0", 1)
    paced += "\n[[belt.changes]]\nat_s = 0.5\nfor_s = 0.4\nfactor = 0.5\n"
    (tmp_path / "paced.toml").write_text(paced)
    options = ("--scenario", str(tmp_path / "paced.toml"), "--boards", "1", "--workers", "1")
    code, report, output = rig_run(tmp_path, films, *options)
    assert (code, report["failings"]) == (0, []), output
    [board] = report["boards"]
    assert board["status"] == "ok"
    assert board["ok"] == board["proven"] == report["cameras"] * board["rows_due"] > 0


def test_configuration_of_a_rig_has_addresses_of_devices_only(tmp_path: Path, films: Path) -> None:
    need_all()
    out = tmp_path / "rig"
    command = [sys.executable, "-m", "vaoi_station", "rig", "up", "--scenario", "small", "--own-network"]
    with subprocess.Popen(
        [*command, "--different", "1", "--films", str(films), "--out", str(out)],
        cwd=ROOT, env=os.environ | {"PYTHONUNBUFFERED": "1"}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        output: list[str] = []
        for line in process.stdout:
            output.append(line)
            if "Press Ctrl-C to stop" in line:
                break
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        enter = (
            next(line for line in output if "vaoi serve" in line).partition(":")[2].partition("vaoi serve")[0].split()
        )
        assert b"127.0.0.3/8" in subprocess.check_output([*enter, "ip", "address", "show", "lo"])
        process.send_signal(signal.SIGINT)
        output.append(process.stdout.read())
        assert process.wait(30) == 0, "".join(output)
    assert len(children) >= 3, "".join(output)
    # The tracker of multiprocessing ends a little after its parent.
    assert all(ends_within(int(pid), 10.0) for pid in children)
    config = read_config(out / "station.toml")
    assert [camera.address for camera in config.cameras] == ["127.0.0.2", "127.0.0.3"]
    assert all(camera.nominal_center_mm and camera.nominal_px_per_mm for camera in config.cameras)
    assert (config.controller.backend, config.controller.port) == ("serial", str(out / "trigger"))
    assert (config.simulation, config.replay) == (None, None)
    assert f"vaoi serve --config {out / 'station.toml'}" in "".join(output)
