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

import httpx2
import pytest

from tests.system.test_service import TIMEOUT_S, Service, as_toml
from vaoi_station.config import StationConfig

SIZE = 3_000_000
"""Size of the data disk in bytes: a few hundred runs of the small board."""


class SmallDisk:
    """A file system of `size` bytes over a directory, visible to commands with `prefix`."""

    def __init__(self, directory: Path, size: int = SIZE) -> None:
        directory.mkdir(exist_ok=True)
        own = [] if os.geteuid() == 0 else ["--map-root-user"]
        mount = f"mount -t tmpfs -o size={size} tmpfs '{directory}' && echo mounted && exec cat"
        self._holder = subprocess.Popen(
            ["unshare", "--mount", *own, "sh", "-c", mount], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == "mounted\n"
        user = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        self.prefix = ["nsenter", f"--target={self._holder.pid}", "--mount", *user, f"--wd={Path.cwd()}"]
        self._mounted_at = directory
        self.directory = Path(f"/proc/{self._holder.pid}/root{directory}")

    def fill(self) -> None:
        # As much as there is: a write is cut short before one is refused.
        with (self.directory / "fill").open("ab", buffering=0) as file, contextlib.suppress(OSError):
            while file.write(bytes(4096)):
                pass

    def make_room(self) -> None:
        (self.directory / "fill").unlink()

    def remount(self, options: str) -> None:
        user = [] if os.geteuid() == 0 else ["--user"]
        mount = ["mount", "-o", f"remount,{options}", str(self._mounted_at)]
        subprocess.run(["nsenter", f"--target={self._holder.pid}", "--mount", *user, *mount], check=True)

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
    deadline_s = time.monotonic() + 4 * TIMEOUT_S
    answer = None
    while True:
        # The server that answers while the station waits for its storage closes its connections when it ends.
        with contextlib.suppress(httpx2.TransportError):
            answer = service.client.get(path)
            if holds(answer):
                return answer.json()
            service.client.get("/runs/next", params={"timeout": 0.2})
        assert time.monotonic() < deadline_s, answer and answer.text


def health(service: Service) -> str:
    return str(service.client.base_url).replace("/api/v1", "/healthz").rstrip("/")


def codes(service: Service) -> list[str]:
    return [warning["code"] for warning in service.get("/station")["warnings"]]


def is_up(*states: str) -> Callable[[Any], bool]:
    return lambda answer: answer.status_code == 200 and answer.json()["state"] in states


def unstored_after(run: str) -> Callable[[Any], bool]:
    return lambda a: a.status_code == 200 and a.json()["stored"] is False and a.json()["id"] > run


def test_a_full_disk_neither_hinders_a_start_nor_filming_and_is_caught_up(
    serve: Callable[[], Service], disk: SmallDisk
) -> None:
    disk.fill()
    service = serve()
    until(service, "/station", is_up("idle"))
    assert "storage-full" in codes(service)
    assert service.client.post("/station/arm", json={"board_type": "small"}).status_code == 200
    first = until(service, "/runs/latest", unstored_after(""))
    assert service.get(f"/runs/{first['id']}/matrices")["status"] == "ok"
    disk.make_room()
    until(service, f"/runs/{first['id']}", lambda a: a.json()["stored"])

    # It dies while the disk is full and a run is in memory only. The next start films on, while the disk is full.
    disk.fill()
    lost = until(service, "/runs/latest", unstored_after(first["id"]))
    service.stop(signal.SIGKILL)
    again = serve()
    shown = until(again, "/station", is_up("armed", "filming"))
    assert shown["armed_with"]["resumed"] is True
    assert "storage-full" in codes(again)
    filmed = until(again, "/runs/latest", unstored_after(lost["id"]))
    disk.make_room()
    until(again, f"/runs/{filmed['id']}", lambda a: a.json()["stored"])
    listed = {run["id"]: run for run in again.get("/runs", limit=500)["runs"]}
    assert {listed[run["id"]]["verdict"] for run in (first, filmed)} == {"ok"}
    assert lost["id"] not in listed or listed[lost["id"]]["reasons"][-1]["code"] == "station-restarted"
    assert again.stop(signal.SIGTERM) == 0, "".join(again.log)

    # A disk that was mounted read-only after a fault is read, and written when it is writable again.
    disk.remount("ro")
    third = serve()
    until(third, "/station", is_up("armed", "filming"))
    assert "storage-read-only" in codes(third)
    assert third.get(f"/runs/{first['id']}")["state"] == "gone"
    later = until(third, "/runs/latest", unstored_after(filmed["id"]))
    disk.remount("rw")
    until(third, f"/runs/{later['id']}", lambda a: a.json()["stored"])
    assert third.stop(signal.SIGTERM) == 0, "".join(third.log)


def test_shared_memory_that_is_too_small_is_named_until_it_is_larger(
    replay_config: Callable[..., StationConfig], tmp_path: Path
) -> None:
    config = tmp_path / "station.toml"
    config.write_text(as_toml(replay_config().model_copy(update={"workers": 1})))
    memory = SmallDisk(tmp_path / "shm", 100_000)
    service = Service(config, memory.prefix)
    try:
        waiting = service.client.get(health(service))
        assert (waiting.status_code, waiting.json()["code"]) == (503, "ring-too-large"), waiting.text
        memory.remount("size=500000000")
        until(service, "/station", lambda answer: answer.status_code == 200)
        assert service.stop(signal.SIGTERM) == 0, "".join(service.log)
    finally:
        if service.process.poll() is None:
            service.process.kill()
            service.process.communicate()
        memory.close()
