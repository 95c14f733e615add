"""`vaoi check-config`: find everything that is wrong in a station.toml and in the files it names, in one pass."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, TypeAdapter, ValidationError

from vaoi_station.config import TABLE_OF, CameraConfig, ControllerConfig, StationConfig, absolute_paths, conflicts
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import configured_files, memory, receivers, running_station, storage
from vaoi_station.doctor.finding import Finding, fault
from vaoi_station.doctor.machine import Machine
from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import Place, faults_of, key_at, read_toml
from vaoi_station.line_config import Line

T = TypeVar("T", bound=BaseModel)
REMEDY = "Correct the file; docs/configuration.md describes every key."
_VALUES = {
    key: TypeAdapter[Any](cast("Any", field.rebuild_annotation())) for key, field in StationConfig.model_fields.items()
}
ALL_KEYS = frozenset(StationConfig.model_fields)
FILE_CHECKS: tuple[tuple[str, frozenset[str], Callable[[CheckContext], Iterable[Finding]]], ...] = (
    ("calibration", frozenset({"calibration", "cameras"}), configured_files.calibration),
    ("board types", frozenset({"board_types"}), configured_files.board_types),
    ("flat fields", frozenset({"flat_fields", "cameras", "program"}), configured_files.flat_fields),
    ("light programs", ALL_KEYS, configured_files.programs),
    ("stand-ins", ALL_KEYS, configured_files.stand_ins),
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
        return [replace(fault(error.message, error.action or REMEDY), check="configuration")]
    sentences, valid = _examine(data)
    findings = [replace(fault(f"{path}: {text}.", REMEDY), check="configuration") for text in sentences]
    config = StationConfig.model_construct(None, **valid)
    config = config.model_copy(update=absolute_paths(config, path.resolve().parent))
    running = running_station.find(config) if valid.keys() >= ALL_KEYS else None
    context = CheckContext(config, machine or Machine(), running)
    for name, needed, check in FILE_CHECKS:
        if needed <= valid.keys():
            findings += [replace(finding, check=name) for finding in check(context)]
    return findings


def _examine(data: dict[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Return the faults of a file as sentences, and the values of the keys that are valid, defaults included."""
    found = _faults(StationConfig, data)
    given = data.get("cameras")
    cameras = given if isinstance(given, list) else []
    # Cameras are checked one by one, so that one faulty camera does not prevent the check of the others.
    for index, camera in enumerate(cameras):
        if isinstance(camera, dict):
            found |= {("cameras", index, *place): text for place, text in _faults(CameraConfig, camera).items()}
    wrong = {place[0] for place in found if place}
    found.pop((), None)  # a conflict between tables: all of them follow here
    valid = {
        key: _VALUES[key].validate_python(data[key]) if key in data else field.get_default()
        for key, field in StationConfig.model_fields.items()
        if key not in wrong
    }
    sound = [camera for c in cameras if (camera := _known(CameraConfig, c)) is not None]
    controller = _known(ControllerConfig, data.get("controller", {}))
    between = [*conflicts(sound, controller, data.keys() & set(TABLE_OF.values()), _known(Line, data.get("line")))]
    if between:
        # It is not clear which devices are meant, so the inputs of simulated or replayed devices are not checked.
        valid.pop("controller", None)
    return [*(f"{key_at(place)}: {text}" for place, text in found.items()), *between], valid


def _faults(model: type[BaseModel], data: dict[str, Any]) -> dict[Place, str]:
    """Return every fault of a table and its place.

    Rules that compare several keys run only if all keys are valid. Therefore faulty keys are removed and the rest is
    validated again, until no new fault is found.
    """
    rest, found = copy.deepcopy(data), dict[Place, str]()
    while True:
        try:
            model.model_validate(rest)
        except ValidationError as error:
            new = {place: text for place, text in faults_of(error) if place not in found}
            # A required key that was removed is now missing; that is no new fault.
            taken_out = [place for place in new if place and _take_out(rest, place)]
            found |= new
            if taken_out:
                continue
        return found


def _take_out(data: Any, place: Place) -> bool:
    """Remove the innermost key of a place from its table; return False if the place is not in the data."""
    owner, last = None, None
    for key in place:
        if isinstance(data, dict) and key in data:
            owner, last = data, key
        elif not isinstance(data, list) or not isinstance(key, int) or key >= len(data):
            break
        data = data[key]
    if owner is None:
        return False
    del owner[last]
    return True


def _known(model: type[T], data: Any) -> T | None:
    """Return the table without its unknown keys, as a validated model; None if its other keys are not valid."""
    if isinstance(data, dict):
        with suppress(ValidationError):
            return model.model_validate({key: value for key, value in data.items() if key in model.model_fields})
    return None
