"""Boards keep coming, the page shows them, until somebody has seen enough."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from vaoi_station.config import ApiConfig
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.temporary_folder import temporary_folder
from vaoi_station.demo.waiting import poll, wait_until_idle

HOST = ApiConfig().host


def show(scenario: Path, port: int | None, tell: Callable[[str], None]) -> NoReturn:
    """Run the station and tell of every board; ends by KeyboardInterrupt, with everything put away.

    Args:
        scenario: of the twin.
        port: of the service; None: the usual one if that is free, else any.
        tell: takes one line.
    """
    tell("Drawing the board …")
    with temporary_folder("demo") as folder:
        config, twin = write_station_files(scenario, folder)
        with Service(config, default_port() if port is None else port) as service:
            client = Client(service.address)
            tell(f"The station's page: {service.address}/  (REST: {service.address}/docs). Ctrl-C ends it.")
            wait_until_idle(client)
            client.post("/station/arm", board_type=twin.board_type.name, job_id="demo")
            number, after = 0, None
            while True:
                run = poll(client, after)
                if run is not None:  # else somebody has disarmed the station, by its page or by REST
                    number, after = number + 1, run["id"]
                    tell(describe_run(number, run))


def describe_run(number: int, run: dict[str, Any]) -> str:
    """What is told of one board."""
    counts, timings, belt = run["counts"], run.get("timings"), run.get("belt")
    words = [f"board {number}: {run['verdict']}", f"{counts['ok']} of {run['rows'] * run['cameras']} frames"]
    if belt:
        words.append(f"belt {100 * (belt['ratio'] - 1):+.2f} %")
    if timings and "ready_after_last_frame_ms" in timings:
        words.append(f"matrices {timings['ready_after_last_frame_ms']:.0f} ms after the last frame")
    return ", ".join((*words, *(reason["message"] for reason in run["reasons"])))


def default_port() -> int:
    """The port a station usually has, if nobody listens there; else 0."""
    with socket.socket() as trial:
        return 0 if trial.connect_ex((HOST, ApiConfig().port)) == 0 else ApiConfig().port
