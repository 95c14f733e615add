"""Run all checks in order: those of `vaoi doctor`, and those of `vaoi check-config`."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from vaoi_station.config import StationConfig, absolute_paths, read_config
from vaoi_station.doctor import (
    camera_checks,
    controller_checks,
    file_checks,
    machine_checks,
    running_station,
    storage_checks,
)
from vaoi_station.doctor.finding import Finding, Report, fault, not_applicable, ok
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.errors import VaoiError
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.files.documents import read_toml
from vaoi_station.settings.faults import examine
from vaoi_station.version import __version__

T = TypeVar("T")
REMEDY = "Correct the file; docs/configuration.md describes every key."
MACHINE_CHECKS: tuple[tuple[str, Callable[[Machine], Iterable[Finding]]], ...] = (
    ("compiled code", machine_checks.compiled_code_cache),
    ("time", machine_checks.wall_clock),
)
STATION_CHECKS: tuple[tuple[str, Callable[[CheckContext], Iterable[Finding]]], ...] = (
    ("station", running_station.station),
    ("calibration", file_checks.calibration),
    ("board types", file_checks.board_types),
    ("flat fields", file_checks.flat_fields),
    ("light programs", file_checks.programs),
    ("stand-ins", file_checks.stand_ins),
    ("certificate", file_checks.station_certificate),
    ("receivers", file_checks.receivers),
    ("neighbours", file_checks.neighbours),
    ("upstream", machine_checks.upstream),
    ("disk", storage_checks.data),
    ("shared memory", machine_checks.ring_space),
    ("memory lock", machine_checks.lock_limit),
    ("aravis", camera_checks.aravis),
    ("socket buffers", machine_checks.socket_buffers),
    ("USB memory", machine_checks.usb_memory),
    ("cameras", camera_checks.cameras),
    ("controller", controller_checks.controller),
)
"""Checks that need a configuration. The running station comes first, because the later checks depend on it."""
ALL_KEYS = frozenset(StationConfig.model_fields)
FILE_CHECKS: dict[str, frozenset[str]] = {
    "calibration": frozenset({"calibration", "cameras"}),
    "board types": frozenset({"board_types"}),
    "flat fields": frozenset({"flat_fields", "board_types", "cameras", "controller", "program"}),
    "light programs": ALL_KEYS,
    "stand-ins": ALL_KEYS,
    "certificate": frozenset({"api"}),
    "receivers": frozenset({"push", "data"}),
    "neighbours": frozenset({"hermes", "board_types"}),
    "disk": frozenset({"data"}),
    "shared memory": frozenset({"ring", "line", "cameras"}),
}
"""Checks of the files that station.toml names, with the keys that must be valid for them."""


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


def check_config(path: Path, machine: Machine | None = None) -> list[Finding]:
    """Return the findings of a station.toml: every fault of the file, then those of the files it names.

    Only an error of the TOML syntax hides other faults, because the rest of the file cannot be read.
    """
    try:
        data = read_toml(path)
    except VaoiError as error:
        return [_wrong(error.message, error.action)]
    faults, valid = examine(data)
    config = StationConfig.model_construct(None, **valid)
    config = config.model_copy(update=absolute_paths(config, path.resolve().parent))
    running = running_station.find(config) if valid.keys() >= ALL_KEYS else None
    context = CheckContext(config, machine or Machine(), running)
    findings = [_wrong(f"{path}: {one}.") for one in faults]
    for name, check in STATION_CHECKS:
        if name in FILE_CHECKS and valid.keys() >= FILE_CHECKS[name]:
            findings += [replace(finding, check=name) for finding in check(context)]
    return findings


def _run_check(name: str, check: Callable[[T], Iterable[Finding]], subject: T) -> list[Finding]:
    """Run one check and return its findings, labelled with the check's name. An exception becomes a finding."""
    try:
        return [replace(finding, check=name) for finding in check(subject)]
    except Exception as error:  # noqa: BLE001  (one broken check must not hide what the others find)
        message = f"the check itself failed: {type(error).__name__}: {error}"
        action = "Report this with the output of vaoi doctor --json."
        return [replace(fault("check-failed", message, action), check=name)]


def _read_configuration(path: Path) -> tuple[StationConfig | None, list[Finding]]:
    try:
        config = read_config(path)
    except VaoiError as error:
        return None, [_wrong(error.message, error.action)]
    backends = sorted({config.controller.backend, *(c.backend for c in config.cameras)})
    message = f"{path}: {len(config.cameras)} cameras, {' and '.join(backends)}"
    return config, [replace(ok(message, cameras=len(config.cameras)), check="configuration")]


def _wrong(message: str, action: str = "") -> Finding:
    return replace(fault("configuration-wrong", message, action or REMEDY), check="configuration")
