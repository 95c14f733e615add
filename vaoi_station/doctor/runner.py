"""Run all checks in order. If a check raises an exception, this is reported as a fault, and the next check is run."""

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
    receivers,
    running_station,
    software,
    station_certificate,
    storage,
    usb,
)
from vaoi_station.doctor.finding import Finding, Report, fault, not_applicable, ok
from vaoi_station.doctor.machine import Machine
from vaoi_station.errors import VaoiError
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.version import __version__

T = TypeVar("T")
MACHINE_CHECKS: tuple[tuple[str, Callable[[Machine], Iterable[Finding]]], ...] = (
    ("python", software.python),
    ("libraries", software.libraries),
    ("compiled code", software.compiled_code_cache),
    ("time", machine_clocks.wall_clock),
    ("monotonic clock", machine_clocks.monotonic_clock),
)
"""Checks that need no configuration: name in the report, and function."""
STATION_CHECKS: tuple[tuple[str, Callable[[CheckContext], Iterable[Finding]]], ...] = (
    ("station", running_station.station),
    ("calibration", configured_files.calibration),
    ("board types", configured_files.board_types),
    ("flat fields", configured_files.flat_fields),
    ("light programs", configured_files.programs),
    ("stand-ins", configured_files.stand_ins),
    ("certificate", station_certificate.station_certificate),
    ("receivers", receivers.receivers),
    ("disk", storage.data),
    ("shared memory", memory.ring_space),
    ("memory lock", memory.lock_limit),
    ("aravis", camera_library.aravis),
    ("socket buffers", network.socket_buffers),
    ("USB memory", usb.memory),
    ("cameras", cameras.cameras),
    ("controller", controller.controller),
)
"""Checks that need a configuration. The running station comes first, because the later checks depend on it."""


def run_checks(path: Path, machine: Machine | None = None, credentials: CallerCredentials | None = None) -> Report:
    """Run all checks for the station that a station.toml describes; `credentials` are for its REST service."""
    machine = machine or Machine()
    config, findings = _read_configuration(path)
    for name, machine_check in MACHINE_CHECKS:
        findings += _run_check(name, machine_check, machine)
    context = None
    if config is None:
        findings.append(replace(not_applicable("all other checks need a readable station.toml"), check="others"))
    else:
        context = CheckContext(config, machine, running_station.find(config, credentials))
        for name, check in STATION_CHECKS:
            findings += _run_check(name, check, context)
    return Report(
        station=config.name if config else "",
        config=str(path),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        host=platform.node(),
        version=__version__,
        running=context.running.pid if context and context.running else None,
        findings=tuple(findings),
    )


def _run_check(name: str, check: Callable[[T], Iterable[Finding]], subject: T) -> list[Finding]:
    """Run one check and return its findings, labelled with the check's name. An exception becomes a finding."""
    try:
        return [replace(finding, check=name) for finding in check(subject)]
    except Exception as error:  # noqa: BLE001  (one broken check must not hide what the others find)
        message = f"the check itself failed: {type(error).__name__}: {error}"
        return [
            replace(
                fault(message, "Report this with the output of vaoi doctor --json.", code="check-failed"), check=name
            )
        ]


def _read_configuration(path: Path) -> tuple[StationConfig | None, list[Finding]]:
    """Read station.toml. If it cannot be read, return a finding of a fault in place of the configuration."""
    try:
        config = read_config(path)
    except VaoiError as error:
        action = error.action or "Correct the file; docs/configuration.md describes every key."
        return None, [replace(fault(error.message, action, code="configuration-wrong"), check="configuration")]
    backends = sorted({config.controller.backend, *(c.backend for c in config.cameras)})
    message = f"{path}: {len(config.cameras)} cameras, {' and '.join(backends)}"
    return config, [replace(ok(message, figures={"cameras": len(config.cameras)}), check="configuration")]
