"""`vaoi check-config`: find everything that is wrong in a station.toml and in the files it names, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from vaoi_station.config import StationConfig, absolute_paths
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import (
    configured_files,
    memory,
    receivers,
    running_station,
    station_certificate,
    storage,
)
from vaoi_station.doctor.finding import Finding, fault
from vaoi_station.doctor.machine import Machine
from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import read_toml
from vaoi_station.settings.faults import examine

REMEDY = "Correct the file; docs/configuration.md describes every key."
ALL_KEYS = frozenset(StationConfig.model_fields)
FILE_CHECKS: tuple[tuple[str, frozenset[str], Callable[[CheckContext], Iterable[Finding]]], ...] = (
    ("calibration", frozenset({"calibration", "cameras"}), configured_files.calibration),
    ("board types", frozenset({"board_types"}), configured_files.board_types),
    (
        "flat fields",
        frozenset({"flat_fields", "board_types", "cameras", "controller", "program"}),
        configured_files.flat_fields,
    ),
    ("light programs", ALL_KEYS, configured_files.programs),
    ("stand-ins", ALL_KEYS, configured_files.stand_ins),
    ("certificate", frozenset({"api"}), station_certificate.station_certificate),
    ("receivers", frozenset({"push", "data"}), receivers.receivers),
    ("disk", frozenset({"data"}), storage.data),
    ("shared memory", frozenset({"ring", "line", "cameras"}), memory.ring_space),
)
"""Checks of the files that station.toml names: name, the keys that must be valid for the check, and the function."""


def check_config(path: Path, machine: Machine | None = None) -> list[Finding]:
    """Return the findings of a station.toml: every fault of the file, then those of the files it names.

    Only an error of the TOML syntax hides other faults, because the rest of the file cannot be read.
    """
    try:
        data = read_toml(path)
    except VaoiError as error:
        return [
            replace(fault(error.message, error.action or REMEDY, code="configuration-wrong"), check="configuration")
        ]
    faults, valid = examine(data)
    findings = [
        replace(fault(f"{path}: {found}.", REMEDY, code="configuration-wrong"), check="configuration")
        for found in faults
    ]
    config = StationConfig.model_construct(None, **valid)
    config = config.model_copy(update=absolute_paths(config, path.resolve().parent))
    running = running_station.find(config) if valid.keys() >= ALL_KEYS else None
    context = CheckContext(config, machine or Machine(), running)
    for name, needed, check in FILE_CHECKS:
        if needed <= valid.keys():
            findings += [replace(finding, check=name) for finding in check(context)]
    return findings
