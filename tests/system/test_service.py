"""`vaoi serve` as a separate program, over HTTP, with an orderly end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tests.api.held.replies import documents, unpacked
from tests.processes import ends_within
from vaoi_station.config import StationConfig

TIMEOUT_S = 150.0


def as_toml(config: StationConfig) -> str:
    """Return a configuration as `station.toml`."""
    document = config.model_dump(mode="json", exclude_none=True)
    cameras, tables = document.pop("cameras"), {k: v for k, v in document.items() if isinstance(v, dict)}
    lines = [f"{k} = {json.dumps(v)}" for k, v in document.items() if k not in tables]
    for name, table in tables.items():
        inner = {k: v for k, v in table.items() if isinstance(v, dict)}
        lines += [f"[{name}]", *(f"{k} = {json.dumps(v)}" for k, v in table.items() if k not in inner)]
        for key, values in inner.items():
            lines += [f"[{name}.{key}]", *(f"{k} = {json.dumps(v)}" for k, v in values.items())]
    for camera in cameras:
        lines += ["[[cameras]]", *(f"{k} = {json.dumps(v)}" for k, v in camera.items())]
    return "\n".join(lines) + "\n"


class Service:
    """The program, its log and its address."""

    def __init__(self, config: Path, prefix: Sequence[str] = ()) -> None:
        self.process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "vaoi_station", "serve", "--config", str(config), "--port", "0"],
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.process.stdout is not None
        self.log: list[str] = []
        for line in self.process.stdout:
            self.log.append(line)
            if found := re.search(r"listening on (http://\S+)", line):
                self.client = httpx2.Client(base_url=found[1] + "/api/v1", timeout=TIMEOUT_S)
                return
        raise AssertionError("".join(self.log))

    def get(self, path: str, **query: Any) -> Any:
        answer = self.client.get(path, params=query)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def until_idle(self) -> None:
        """Wait until workers and cameras are ready; the event stream reports the state every two seconds."""
        with self.client.stream("GET", "/events") as stream:
            assert any('"state":"idle"' in line for line in stream.iter_lines())

    def stop(self, number: int) -> int:
        self.client.close()
        self.process.send_signal(number)
        out, _ = self.process.communicate(timeout=TIMEOUT_S)
        self.log.append(out)
        return self.process.returncode

    def close(self) -> None:
        """End what is left after a test that failed: its process, and its connections."""
        self.client.close()
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


@pytest.fixture
def service(replay_config: Callable[..., StationConfig], tmp_path: Path) -> Iterator[Service]:
    path = tmp_path / "station.toml"
    path.write_text(as_toml(replay_config(pace="original", pause_s=0.3).model_copy(update={"workers": 1})))
    started = Service(path)
    yield started
    started.close()


def test_a_board_passes_and_the_service_ends_in_order(service: Service, tmp_path: Path) -> None:
    service.until_idle()
    armed = service.client.post(
        "/station/arm", json={"board_type": "small", "board_id": "b 1", "job_id": "j 1", "runs": 1}
    )
    assert armed.status_code == 200, armed.text
    assert armed.json()["state"] in ("armed", "filming")
    # One board only: the memory of others would evict its frames before a slow test has fetched them.
    deadline_s = time.monotonic() + TIMEOUT_S
    while (latest := service.client.get("/runs/latest")).status_code == 404:
        assert time.monotonic() < deadline_s
        service.client.get("/runs/next", params={"timeout": 0.2})
    run = latest.json()
    assert (run["board_id"], run["job_id"], run["state"]) == ("b 1", "j 1", "ready")
    matrices = service.get(f"/runs/{run['id']}/matrices")
    assert (matrices["format"], matrices["status"]) == ("vaoi-stitch", "ok")
    assert len(matrices["image_matrices"][0]) == run["rows"]
    frame = service.client.get(f"/runs/{run['id']}/frames/0/0")
    assert frame.content[:4] == b"\x89PNG"
    components = service.get(f"/runs/{run['id']}/components")["components"]
    [address, *_] = [c["address"] for c in components if c["views"]]
    picture = service.client.get(f"/runs/{run['id']}/components/{address}/images/0")
    assert picture.content[:4] == b"\x89PNG"
    wanted = {"component": address, "limit": 1, "container": "zip"}
    files = unpacked(service.client.get(f"/runs/{run['id']}/images", params=wanted).content, "zip")
    end = documents(files)["end.json"]
    assert end == {"complete": True, "components": 1, "refused": 0, "images": 1}
    assert files[f"components/{address}/0.png"] == picture.content
    pids = [p["pid"] for p in service.get("/station")["processes"]]
    assert len(pids) == 3
    assert service.stop(signal.SIGTERM) == 0, "".join(service.log)
    assert list((tmp_path / "shm").iterdir()) == []
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def test_killed_station_leaves_no_process_and_the_next_one_removes_its_ring(service: Service, tmp_path: Path) -> None:
    service.until_idle()
    pids = [p["pid"] for p in service.get("/station")["processes"]]
    service.stop(signal.SIGKILL)
    for pid in pids:
        assert ends_within(pid, TIMEOUT_S), f"process {pid} outlived its station"
    assert len(list((tmp_path / "shm").iterdir())) == 1
    with closing(Service(tmp_path / "station.toml")) as again:
        again.until_idle()
        pids = [p["pid"] for p in again.get("/station")["processes"]]
        assert again.stop(signal.SIGINT) == 0, "".join(again.log)
    assert list((tmp_path / "shm").iterdir()) == []
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


WITHOUT_STOP = """
import sys
import time
from pathlib import Path
from vaoi_station.config import read_config
from vaoi_station.station import Station

if __name__ == "__main__":
    station = Station(read_config(Path(sys.argv[1])))
    station.start()
    while station.coordinator.snapshot().state == "starting":
        station.coordinator.events(10**9, 0.2)
    print(*(p.pid for p in station.coordinator.snapshot().processes if p.pid), flush=True)
"""


def test_a_damaged_file_of_keys_keeps_no_board_from_being_filmed(
    replay_config: Callable[..., StationConfig], tmp_path: Path
) -> None:
    """An exit with code 2 would be the last: systemd does not start the service again after it."""
    configured = replay_config().model_copy(update={"workers": 1})
    config = tmp_path / "station.toml"
    config.write_text(as_toml(configured))
    configured.data.mkdir(exist_ok=True)
    (configured.data / "keys.json").write_text('{"format": "vaoi-keys", "version": 1, "keys": [')
    service = Service(config)
    try:
        service.until_idle()
        assert service.client.get("/keys").status_code == 403
        refused = service.client.get("/station", headers={"Authorization": f"Bearer vaoi_{'0' * 12}_x"})
        assert refused.status_code >= 400
        assert any("keys.json" in line and "callers with a key are refused" in line for line in service.log)
        assert service.stop(signal.SIGTERM) == 0, "".join(service.log)
    finally:
        service.close()


def test_station_that_is_not_stopped_ends_with_its_program(
    replay_config: Callable[..., StationConfig], tmp_path: Path
) -> None:
    (tmp_path / "station.toml").write_text(as_toml(replay_config().model_copy(update={"workers": 1})))
    (tmp_path / "without_stop.py").write_text(WITHOUT_STOP)
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, str(tmp_path / "without_stop.py"), str(tmp_path / "station.toml")],
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE,
        text=True,
        timeout=TIMEOUT_S,
        check=True,
    )
    for pid in done.stdout.split():
        assert ends_within(int(pid), TIMEOUT_S), f"process {pid} outlived its station"
