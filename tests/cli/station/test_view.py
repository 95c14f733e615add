"""`vaoi view --once`: figures as text and as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.doctor.check_context import RunningProcess
from vaoi_station.errors import InputError
from vaoi_station.simulation import Twin, calibration_board, read_scenario, scenario_path


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A station on the twin."""
    return write_station_files(scenario_path("small"), tmp_path)[0]


def test_json_output_is_one_document(config: Path) -> None:
    command = ["view", "--config", str(config), "--once", "--json", "--boards", "--row", "2", "--mark", "circle"]
    done = CliRunner().invoke(app, [*command, "--mark-size-mm", "1.0"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["row"], [c["camera"] for c in document["cameras"]]) == (2, [0, 1])
    for camera in document["cameras"]:
        assert 0.3 < camera["figures"]["blur_px"] < 1.3
        assert 0 < camera["figures"]["mean"] < 1
        assert camera["mark_size_px"] == pytest.approx(18, abs=0.5)


def test_calibration_board_at_rest_is_measured(config: Path, tmp_path: Path) -> None:
    twin = Twin(read_scenario(scenario_path("small")))
    (tmp_path / "layout.json").write_text(json.dumps(calibration_board.layout(twin)))
    command = ["view", "--config", str(config), "--once", "--json", "--layout", str(tmp_path / "layout.json")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["run"], document["row"], document["rows"]) == ("001", 0, 1)
    for camera in document["cameras"]:
        assert len(camera["marks"]) == 4
        assert 0.3 < camera["figures"]["blur_px"] < 1.3
        places = calibration_board.mark_places_mm(twin)[4 * camera["camera"] :][:4]
        seen = twin.pinholes[camera["camera"]].project(places, 0.0)
        for mark in camera["marks"]:
            assert min(np.hypot(*(seen - (mark["x"], mark["y"])).T)) < 0.1


def test_text_output_has_one_line_per_camera(config: Path) -> None:
    done = CliRunner().invoke(app, ["view", "--config", str(config), "--once", "--boards"])
    assert done.exit_code == 0, done.output
    assert "run 001, row 3 of 6" in done.stdout
    assert "camera 1 (camera 1): focus " in done.stdout


def test_options_that_exclude_each_other_are_refused(config: Path) -> None:
    for options in (["--json"], ["--row", "1"], ["--once", "--row", "0"], ["--once", "--mark", "cross"]):
        refused = CliRunner().invoke(app, ["view", "--config", str(config), *options])
        assert isinstance(refused.exception, InputError), options


def test_beside_a_running_station_its_page_is_named(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    running = RunningProcess(1, snapshot={"state": "armed"})
    monkeypatch.setattr("vaoi_station.doctor.checks.running_station.find", lambda _: running)
    done = CliRunner().invoke(app, ["view", "--config", str(config)])
    assert done.exit_code == 0, done.output
    port = read_config(config).api.port
    assert f"Its page shows them: http://127.0.0.1:{port}/#/cameras" in done.stdout
