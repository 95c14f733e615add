"""A camera is exchanged on the virtual rig: search, place, boards, confirmation, without a restart of any process."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.needs import need_aravis, need_emulator
from tests.processes import run_in_own_network
from tests.rig.exchange import ADDRESS, NEW

pytestmark = pytest.mark.aravis


def test_a_camera_is_exchanged_and_calibrated_by_one_board_while_the_station_runs(tmp_path: Path) -> None:
    need_emulator()
    need_aravis()
    done = run_in_own_network(sys.executable, "-m", "tests.rig.exchange", str(tmp_path))
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout)
    assert seen["before"] == "ok"
    assert [(gone["serial"], gone["candidates"]) for gone in seen["gone"]] == [("VAOI-01", [NEW])]
    assert (seen["status"]["serial"], seen["status"]["address"]) == (NEW, ADDRESS)
    assert {run["verdict"] for run in seen["runs"]} == {"degraded"}
    assert all("camera-not-calibrated" in run["causes"] for run in seen["runs"])
    assert seen["confirmed"]["cameras"] == [1]
    assert 0 < seen["confirmed"]["sigma_px"] < 0.1
    assert (seen["after"]["verdict"], seen["after"]["reasons"], seen["warnings"]) == ("ok", [], [])
    before, after = seen["processes"]
    assert before == after, "no process was started again"
    assert f'serial = "{NEW}"' in seen["settings"]
    assert 'address = "127.0.0.3"' not in seen["settings"]
