"""Run the station on the twin, and let board after board pass, until Ctrl-C."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from vaoi_station.config import ApiConfig
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service, refuse_taken_port
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.temporary_folder import temporary_folder
from vaoi_station.demo.waiting import poll, wait_until_idle


def run_continuously(scenario: Path, port: int | None, report: Callable[[str], None]) -> NoReturn:
    """Run the station and report every board until KeyboardInterrupt; then end its processes and remove its files.

    Args:
        scenario: file of the twin's scenario.
        port: port of the service; None for the default port, 0 for any free port.
        report: is called with one line per board.

    Raises:
        DeviceError: the port is in use.
    """
    port = ApiConfig().port if port is None else port
    # Another station may already run here. A program that expects the demo at this port would talk to that station.
    refuse_taken_port(port)
    report("Drawing the board …")
    with temporary_folder("demo") as folder:
        config, twin = write_station_files(scenario, folder)
        with Service(config, port) as service:
            client = Client(service.address)
            report(f"The station's page: {service.address}/  (REST: {service.address}/docs). Ctrl-C ends it.")
            given = shlex.quote(str(config))
            report(f"A key for the pages under Set up: vaoi keys create me --scope admin --config {given}")
            wait_until_idle(client, report)
            client.post("/station/arm", board_type=twin.board_type.name, job_id="demo")
            number, after = 0, None
            while True:
                run = poll(client, after)
                if run is not None:  # None if the station was disarmed meanwhile, from its page or by REST
                    number, after = number + 1, run["id"]
                    report(describe_run(number, run))


def describe_run(number: int, run: dict[str, Any]) -> str:
    """Return one line of text that describes a run."""
    counts, timings, belt = run["counts"], run.get("timings"), run.get("belt")
    words = [f"board {number}: {run['verdict']}", f"{counts['ok']} of {run['rows'] * run['cameras']} frames"]
    if belt:
        words.append(f"belt {100 * (belt['ratio'] - 1):+.2f} %")
    if timings and "ready_after_last_frame_ms" in timings:
        words.append(f"matrices {timings['ready_after_last_frame_ms']:.0f} ms after the last frame")
    return ", ".join((*words, *(reason["message"] for reason in run["reasons"])))
