"""The station under test: `vaoi serve` as a process that is started again whenever it ends, as systemd does."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2

ROOT = Path(__file__).resolve().parents[2]
START_S = 400.0
"""Longest time until the station has opened its port."""
RESTART_S = 0.5
"""Pause before a new start."""
REQUEST_S = 15.0
STOP_S = 60.0


@dataclass
class Ends:
    """How often the process has ended."""

    wanted: int = 0
    """Killed by a fault of the soak."""
    own: list[int] = field(default_factory=list)
    """Exit codes of the ends that no fault has caused directly."""


class Service:
    """The program with its log, its address and its supervisor."""

    def __init__(self, config: Path, log: Path, prefix: Sequence[str] = ()) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self._command = [
            *prefix, sys.executable, "-m", "vaoi_station", "serve", "--config", str(config), "--port", str(self.port),
        ]  # fmt: skip
        self._log = log
        self.ends = Ends()
        self._closing = threading.Event()
        self._kill_wanted = False
        self.process = self._start()
        self._thread = threading.Thread(target=self._supervise, name="supervisor")
        self._thread.start()

    @property
    def url(self) -> str:
        """The address of the REST interface."""
        return f"http://127.0.0.1:{self.port}/api/v1"

    def client(self) -> httpx2.Client:
        """Return a client of its own for a thread."""
        return httpx2.Client(base_url=self.url, timeout=REQUEST_S)

    def kill(self) -> None:
        """End the station as a power cut would."""
        self._kill_wanted = True
        os.kill(self.pid, signal.SIGKILL)

    @property
    def pid(self) -> int:
        """The station's process id; `nsenter` replaces itself by the program."""
        return self.process.pid

    def stop(self) -> int:
        """End the station in order; return its exit code, or that of SIGKILL if it does not end."""
        self._closing.set()
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._thread.join()
        return self.process.returncode

    def log(self) -> str:
        """Return everything that the station has written."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def _start(self) -> subprocess.Popen[bytes]:
        # A file, not a pipe: the workers hold it open until they have ended as well.
        with self._log.open("ab") as log:
            return subprocess.Popen(self._command, cwd=ROOT, stdout=log, stderr=log)

    def _supervise(self) -> None:
        while True:
            code = self.process.wait()
            if self._closing.is_set():
                return
            if self._kill_wanted:
                self._kill_wanted = False
                self.ends.wanted += 1
            else:
                self.ends.own.append(code)
            if self._closing.wait(RESTART_S):
                return
            self.process = self._start()


def ask(client: httpx2.Client, path: str, **query: Any) -> Any:
    """Return the document at a path, or None if the station does not answer, or refuses."""
    with suppress(httpx2.HTTPError):
        answer = client.get(path, params=query)
        if answer.status_code == 200:
            return answer.json()
    return None


def wait_until(service: Service, states: Sequence[str], timeout_s: float = START_S) -> dict[str, Any]:
    """Wait until the station is in one of these states; return its document."""
    deadline_s, pause = time.monotonic() + timeout_s, threading.Event()
    with service.client() as client:
        while True:
            station = ask(client, "/station")
            if station and station["state"] in states:
                return dict(station)
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"not {states} within {timeout_s} s: {station}\n{service.log()[-2000:]}")
            pause.wait(0.1)


def events_of(service: Service, last: int) -> list[dict[str, Any]]:
    """Return all events that are kept, up to number `last`."""
    found: list[dict[str, Any]] = []
    with service.client() as client, client.stream("GET", "/events", params={"after": 0}) as stream:
        for line in stream.iter_lines():
            if match := re.match(r"data: (\{.*\})", line):
                event = httpx2.Response(200, content=match[1]).json()
                if "number" in event:
                    found.append(event)
                    if event["number"] >= last:
                        break
    return found
