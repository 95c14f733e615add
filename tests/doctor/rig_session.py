"""Run the doctor on a virtual rig: before a station starts, while it runs, and after it has stopped.

    python -m tests.doctor.rig_session DIRECTORY

Runs in its own network name space. Prints one JSON object: the three reports, and the station's processes before and
after the check beside it.
"""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vaoi_station.config import StationConfig, read_config
from vaoi_station.doctor import run_checks
from vaoi_station.doctor.running_station import ask

TIMEOUT_S = 120.0


@contextmanager
def ended_by(number: signal.Signals, process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """Send a signal to a process at the end of the block, and wait until it has ended."""
    try:
        yield process
    finally:
        process.send_signal(number)
        process.communicate(timeout=TIMEOUT_S)


@contextmanager
def killed_on_error(process: subprocess.Popen[str]) -> Iterator[None]:
    """Kill a process if the block fails."""
    try:
        yield
    except BaseException:  # also KeyboardInterrupt: end the process, then raise it again
        process.kill()
        process.communicate()
        raise


def rig(directory: Path) -> subprocess.Popen[str]:
    """Start the emulated devices and wait until they are ready."""
    command = [sys.executable, "-m", "vaoi_station", "rig", "up", "--out", str(directory)]
    command += ["--scenario", "small", "--different", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    with killed_on_error(process):
        assert process.stdout is not None
        assert any("Boards pass" in line for line in process.stdout)
    return process


def service(path: Path, config: StationConfig) -> subprocess.Popen[str]:
    """Start a station and wait until it is idle."""
    address = path.with_name("notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        notify.bind(str(address))
        notify.settimeout(TIMEOUT_S)
        command = [sys.executable, "-m", "vaoi_station", "serve", "--config", str(path)]
        environment = os.environ | {"NOTIFY_SOCKET": str(address)}
        process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, text=True)
        with killed_on_error(process):
            while b"READY=1" not in notify.recv(4096):
                pass
            wait_until_idle(config)
    return process


def state(config: StationConfig) -> dict[str, Any]:
    """Ask a station for its state, again until the limit of this session: on a busy machine one reply may be late."""
    end_s = time.monotonic() + TIMEOUT_S
    while True:
        try:
            return ask(config.api)
        except TimeoutError:
            if time.monotonic() > end_s:
                raise


def wait_until_idle(config: StationConfig) -> None:
    """Wait until the station is idle; the event stream wakes the loop at least every two seconds."""
    connection = http.client.HTTPConnection(config.api.host, config.api.port, timeout=TIMEOUT_S)
    connection.request("GET", "/api/v1/events")
    stream = connection.getresponse()
    while state(config)["state"] != "idle":
        stream.readline()
    connection.close()


def processes(config: StationConfig) -> list[Any]:
    """Return the station's processes; a restarted process has another pid."""
    return [(process["name"], process["pid"], process["restarts"]) for process in state(config)["processes"]]


def main(directory: Path) -> None:
    path = directory / "station.toml"
    with ended_by(signal.SIGINT, rig(directory)):
        config = read_config(path)
        before = run_checks(path)
        with ended_by(signal.SIGTERM, service(path, config)):
            untouched = processes(config)
            beside = run_checks(path)
            touched = processes(config)
        after = run_checks(path)
    reports = {"before": before.document(), "beside": beside.document(), "after": after.document()}
    print(json.dumps(reports | {"processes": [untouched, touched]}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
