"""`vaoi serve` on a data disk that is really full: a small file system in a mount namespace of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.system.test_service import TIMEOUT_S, Service, as_toml
from vaoi_station.config import StationConfig

SIZE = 3_000_000
"""Size of the data disk in bytes: a few hundred runs of the small board."""


class SmallDisk:
    """A file system of `SIZE` bytes over a directory, visible to commands with `prefix`."""

    def __init__(self, directory: Path) -> None:
        directory.mkdir(exist_ok=True)
        own = [] if os.geteuid() == 0 else ["--map-root-user"]
        mount = f"mount -t tmpfs -o size={SIZE} tmpfs '{directory}' && echo mounted && exec cat"
        self._holder = subprocess.Popen(
            ["unshare", "--mount", *own, "sh", "-c", mount], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == "mounted\n"
        user = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        self.prefix = ["nsenter", f"--target={self._holder.pid}", "--mount", *user, f"--wd={Path.cwd()}"]
        self.directory = Path(f"/proc/{self._holder.pid}/root{directory}")

    def fill(self) -> None:
        # As much as there is: a write is cut short before one is refused.
        with (self.directory / "fill").open("ab", buffering=0) as file, contextlib.suppress(OSError):
            while file.write(bytes(4096)):
                pass

    def make_room(self) -> None:
        (self.directory / "fill").unlink()

    def close(self) -> None:
        self._holder.communicate()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    made = SmallDisk(tmp_path / "data")
    yield made
    made.close()


@pytest.fixture
def serve(
    replay_config: Callable[..., StationConfig], tmp_path: Path, disk: SmallDisk
) -> Iterator[Callable[[], Service]]:
    """Return a function that starts the service on the small disk."""
    config = tmp_path / "station.toml"
    config.write_text(as_toml(replay_config(pace="original", pause_s=0.3).model_copy(update={"workers": 1})))
    started: list[Service] = []

    def start() -> Service:
        started.append(Service(config, disk.prefix))
        return started[-1]

    yield start
    for service in started:
        service.close()


def until(service: Service, path: str, holds: Callable[[Any], bool]) -> Any:
    """Ask until a condition holds; a request at `runs/next` takes the time between two questions."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while True:
        answer = service.client.get(path)
        if holds(answer):
            return answer.json()
        assert time.monotonic() < deadline_s, answer.text
        service.client.get("/runs/next", params={"timeout": 0.2})


def health(service: Service) -> str:
    return str(service.client.base_url).replace("/api/v1", "/healthz").rstrip("/")


def test_a_full_disk_is_waited_for_named_and_caught_up(serve: Callable[[], Service], disk: SmallDisk) -> None:
    disk.fill()
    service = serve()
    waiting = service.client.get(health(service))
    assert (waiting.status_code, waiting.json()["code"]) == (503, "storage-full"), waiting.text
    disk.make_room()
    until(service, "/station", lambda a: a.status_code == 200 and a.json()["state"] == "idle")
    assert service.client.post("/station/arm", json={"board_type": "small"}).status_code == 200
    first = service.get("/runs/next", timeout=50)
    assert first["stored"] is True

    disk.fill()
    unstored = until(service, "/runs/latest", lambda a: a.json()["stored"] is False)
    assert service.get(f"/runs/{unstored['id']}/matrices")["status"] == "ok"
    warnings = [warning["code"] for warning in service.get("/station")["warnings"]]
    assert "storage-full" in warnings
    disk.make_room()
    until(service, f"/runs/{unstored['id']}", lambda a: a.json()["stored"])

    # It dies while the disk is full and a run is in memory only. The next start waits, and then accepts what it finds.
    disk.fill()
    lost = until(service, "/runs/latest", lambda a: a.json()["stored"] is False and a.json()["id"] > unstored["id"])
    service.stop(signal.SIGKILL)
    again = serve()
    disk.make_room()
    shown = until(again, "/station", lambda a: a.status_code == 200 and a.json()["state"] in ("armed", "filming"))
    assert shown["armed_with"]["resumed"] is True
    listed = {run["id"]: run for run in again.get("/runs", limit=500)["runs"]}
    assert {listed[run["id"]]["verdict"] for run in (first, unstored)} == {"ok"}
    assert lost["id"] not in listed or listed[lost["id"]]["reasons"][-1]["code"] == "station-restarted"
    assert again.stop(signal.SIGTERM) == 0, "".join(again.log)
