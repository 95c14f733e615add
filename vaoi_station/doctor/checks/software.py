"""Interpreter, libraries, and the place for compiled code."""

from __future__ import annotations

import importlib
import os
import platform
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from vaoi_station import version
from vaoi_station.doctor.finding import Finding, fault, ok, warning
from vaoi_station.doctor.machine import Machine, writable

OLDEST, FIRST_UNTRIED = (3, 11), (3, 14)
LIBRARIES = {"numpy": "numpy", "numba": "numba", "cv2": "opencv-python-headless", "pydantic": "pydantic"}
PACKAGE = Path(version.__file__).parent


def python(_: Machine) -> Iterator[Finding]:
    """The interpreter that runs this, which is the one the station would run on."""
    yield judge_python(sys.version_info[:2], 8 * struct.calcsize("P"), platform.python_version(), sys.executable)


def judge_python(version: tuple[int, int], bits: int, shown: str, where: str) -> Finding:
    """Whether a Python will do."""
    told = f"Python {shown}, {bits} bit, {where}"
    if bits < 64:
        return fault(f"{told}: the ring needs more address space than 32 bit have.", "Install a 64-bit system.")
    if not OLDEST <= version < FIRST_UNTRIED:
        return fault(
            f"{told}: vaoi_station runs on 3.11 to 3.13.", "python3.11 -m venv .venv && .venv/bin/pip install ."
        )
    return ok(told, figures={"python": shown})


def libraries(_: Machine) -> Iterator[Finding]:
    """What the station cannot do without."""
    versions = {}
    for name, package in LIBRARIES.items():
        try:
            versions[name] = str(importlib.import_module(name).__version__)
        except ImportError as error:
            yield fault(f"{name} cannot be imported: {error}.", f"{sys.executable} -m pip install {package}")
    if len(versions) == len(LIBRARIES):
        yield ok(", ".join(f"{name} {version}" for name, version in versions.items()), figures=versions)


def compiled_code_cache(_: Machine) -> Iterator[Finding]:
    """Where compiled inner loops are kept: in NUMBA_CACHE_DIR, else beside the package, else in the user's cache."""
    yield judge_cache(os.environ.get("NUMBA_CACHE_DIR"), PACKAGE, Path.home())


def judge_cache(given: str | None, package: Path, home: Path) -> Finding:
    """Whether one of the places takes files."""
    if given:
        if writable(Path(given)):
            return ok(f"is kept in {given}")
        told = f"NUMBA_CACHE_DIR={given} cannot be written to"
        return warning(
            f"{told}: every start compiles for half a minute.", f"install -d -o $USER {given}, or unset NUMBA_CACHE_DIR"
        )
    places = (package / "__pycache__", Path(os.environ.get("XDG_CACHE_HOME", home / ".cache")) / "numba")
    for place in places:
        if writable(place):
            return ok(f"is kept in {place}")
    return warning(
        f"neither {places[0]} nor {places[1]} can be written to: every start compiles for half a minute.",
        "export NUMBA_CACHE_DIR=DIRECTORY, one of this user; deploy/vaoi-station.service has it",
    )
