"""Filming with `vaoi view`: one row as a document, and the live page."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import httpx2
import pytest

from vaoi_station.config import StationConfig
from vaoi_station.demo.station_files import to_toml
from vaoi_station.errors import InputError
from vaoi_station.viewing.live_view import one_row
from vaoi_station.viewing.mark_spec import MarkSpec

Make = Callable[..., StationConfig]
View = Callable[..., AbstractContextManager[tuple[str, subprocess.Popen[str]]]]
SPEC = MarkSpec("cross", 24.0, light=False)


def test_one_row_is_reported_with_its_missing_frames(make_config: Make, tmp_path: Path) -> None:
    document = one_row(make_config(), [SPEC, None], None, lambda _: None)
    assert (document["row"], document["rows"], len(document["cameras"])) == (1, 3, 2)
    assert len(document["cameras"][0]["marks"]) == 4
    last = one_row(make_config(), [SPEC, None], 2, lambda _: None)
    assert last["cameras"][1]["name"] == "c1"
    assert last["cameras"][1]["missing"]
    assert list((tmp_path / "shm").iterdir()) == []


def test_a_row_beyond_the_run_is_refused_without_leftovers(make_config: Make, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--row: row is 3, but must be below 3"):
        one_row(make_config(), [None, None], 3, lambda _: None)
    assert list((tmp_path / "shm").iterdir()) == []


def look(client: httpx2.Client, after: int) -> dict[str, Any]:
    document: dict[str, Any] = client.get("/api/look", params={"after": after, "timeout_s": 5}).json()
    return document


def test_frames_come_until_it_is_stopped(make_config: Make, layout: Path, tmp_path: Path, viewing: View) -> None:
    config = make_config(nominal_px_per_mm=10.0, nominal_center_mm=(0.0, 0.0))
    with (
        viewing(config, tmp_path, "--boards", "--layout", str(layout)) as (address, _),
        httpx2.Client(base_url=address, timeout=60) as client,
    ):
        number, runs = 0, set[str]()
        while len(runs) < 3:
            document = look(client, number)
            assert document["number"] >= number
            number = document["number"]
            runs |= {c["run"] for c in document["cameras"]}
            for camera in document["cameras"]:
                params = {"number": camera["number"]}
                assert client.get(f"/api/cameras/{camera['camera']}/picture", params=params).status_code == 200
        assert [len(c["marks"]) for c in document["cameras"] if c["camera"] == 0] == [4]
    assert list((tmp_path / "shm").iterdir()) == []


def test_a_replay_without_its_boards_is_refused(make_config: Make, tmp_path: Path) -> None:
    (tmp_path / "station.toml").write_text(to_toml(make_config()))
    command = [sys.executable, "-m", "vaoi_station", "view", "--config", str(tmp_path / "station.toml"), "--port", "0"]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode != 0
    assert "a replay plays recorded boards; it cannot fire a pulse of its own." in refused.stderr
    assert "--boards" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert list((tmp_path / "shm").iterdir()) == []


def test_the_last_frames_stay_after_the_last_board(make_config: Make, tmp_path: Path, viewing: View) -> None:
    config = make_config()
    assert config.replay is not None
    few = config.model_copy(update={"replay": config.replay.model_copy(update={"runs": 1})})
    with (
        viewing(few, tmp_path, "--boards") as (address, process),
        httpx2.Client(base_url=address, timeout=60) as client,
    ):
        assert process.stdout is not None
        said = [process.stdout.readline() for _ in range(2)]
        assert "No more boards" in said[-1], said
        document = look(client, 0)
        assert {(c["camera"], c["row"]) for c in document["cameras"]} == {(0, 2), (1, 1)}
        assert document["notices"][-1] == "No more boards; these are the last frames."
    assert list((tmp_path / "shm").iterdir()) == []


def test_a_port_in_use_is_refused(make_config: Make, tmp_path: Path, viewing: View) -> None:
    with viewing(make_config(), tmp_path, "--boards") as (address, _):
        port = address.rsplit(":", 1)[1]
        command = [sys.executable, "-m", "vaoi_station", "view", "--config", str(tmp_path / "station.toml")]
        second = subprocess.run([*command, "--port", port], capture_output=True, text=True, timeout=60, check=False)
    assert second.returncode == 3
    assert f"--port: cannot listen on 127.0.0.1 port {port}" in second.stderr
