"""The checks in their order. One that goes wrong itself is told as a fault, and the others go on."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from vaoi_station.config import StationConfig, read_config
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import (
    camera_library,
    cameras,
    configured_files,
    controller,
    machine_clocks,
    memory,
    network,
    running_station,
    software,
    storage,
    usb,
)
from vaoi_station.doctor.finding import Finding, Report, fault, not_applicable, ok
from vaoi_station.doctor.machine import Machine
from vaoi_station.errors import VaoiError
from vaoi_station.version import __version__

T = TypeVar("T")
MACHINE_CHECKS: tuple[tuple[str, Callable[[Machine], Iterable[Finding]]], ...] = (
    ("python", software.python),
    ("libraries", software.libraries),
    ("compiled code", software.compiled_code_cache),
    ("time", machine_clocks.wall_clock),
    ("monotonic clock", machine_clocks.monotonic_clock),
)
"""What can be looked at without a configuration."""
STATION_CHECKS: tuple[tuple[str, Callable[[CheckContext], Iterable[Finding]]], ...] = (
    ("station", running_station.station),
    ("calibration", configured_files.calibration),
    ("board types", configured_files.board_types),
    ("stand-ins", configured_files.stand_ins),
    ("disk", storage.data),
    ("shared memory", memory.ring_space),
    ("memory lock", memory.lock_limit),
    ("aravis", camera_library.aravis),
    ("socket buffers", network.socket_buffers),
    ("USB memory", usb.memory),
    ("cameras", cameras.cameras),
    ("controller", controller.controller),
)
"""The others."""


def run_checks(path: Path, machine: Machine | None = None) -> Report:
    """Carry out all checks for the station of a station.toml."""
    machine = machine or Machine()
    config, findings = _configuration(path)
    for name, look in MACHINE_CHECKS:
        findings += _carried_out(name, look, machine)
    context = None
    if config is None:
        findings.append(replace(not_applicable("all others need a station.toml that can be read"), check="others"))
    else:
        context = CheckContext(config, machine, running_station.find(config))
        for name, check in STATION_CHECKS:
            findings += _carried_out(name, check, context)
    return Report(
        station=config.name if config else "",
        config=str(path),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        host=platform.node(),
        version=__version__,
        running=context.running.pid if context and context.running else None,
        findings=tuple(findings),
    )


def _carried_out(name: str, check: Callable[[T], Iterable[Finding]], subject: T) -> list[Finding]:
    """What a check finds, under its name; if it goes wrong, that is a finding too."""
    try:
        return [replace(finding, check=name) for finding in check(subject)]
    except Exception as error:  # noqa: BLE001  (one broken check must not hide what the others find)
        told = f"the check itself failed: {type(error).__name__}: {error}"
        return [replace(fault(told, "Please report it, with vaoi doctor --json."), check=name)]


def _configuration(path: Path) -> tuple[StationConfig | None, list[Finding]]:
    try:
        config = read_config(path)
    except VaoiError as error:
        action = error.action or "Correct the file; docs/configuration.md says every key."
        return None, [replace(fault(error.message, action), check="configuration")]
    backends = sorted({config.controller.backend, *(c.backend for c in config.cameras)})
    told = f"{path}: {len(config.cameras)} cameras, {' and '.join(backends)}"
    return config, [replace(ok(told, figures={"cameras": len(config.cameras)}), check="configuration")]
