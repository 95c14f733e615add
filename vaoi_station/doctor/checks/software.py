"""Check the Python interpreter, the libraries, and the cache for compiled code."""

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
    """Check the Python interpreter that runs this command. The station uses the same one."""
    yield judge_python(sys.version_info[:2], 8 * struct.calcsize("P"), platform.python_version(), sys.executable)


def judge_python(version: tuple[int, int], bits: int, shown: str, where: str) -> Finding:
    """Judge the version of a Python interpreter, and whether it is a 64-bit program."""
    message = f"Python {shown}, {bits} bit, {where}"
    if bits < 64:
        return fault(f"{message}: the ring needs more address space than 32 bit offer.", "Install a 64-bit system.")
    if not OLDEST <= version < FIRST_UNTRIED:
        return fault(
            f"{message}: vaoi_station needs Python 3.11 to 3.13.", "python3.11 -m venv .venv && .venv/bin/pip install ."
        )
    return ok(message, figures={"python": shown})


def libraries(_: Machine) -> Iterator[Finding]:
    """Check that the required libraries can be imported."""
    versions = {}
    for name, package in LIBRARIES.items():
        try:
            versions[name] = str(importlib.import_module(name).__version__)
        except ImportError as error:
            yield fault(f"{name} cannot be imported: {error}.", f"{sys.executable} -m pip install {package}")
    if len(versions) == len(LIBRARIES):
        yield ok(", ".join(f"{name} {version}" for name, version in versions.items()), figures=versions)


def compiled_code_cache(_: Machine) -> Iterator[Finding]:
    """Check that Numba can store compiled inner loops in one of the folders that it tries."""
    yield judge_cache(os.environ.get("NUMBA_CACHE_DIR"), PACKAGE, Path.home())


def judge_cache(given: str | None, package: Path, home: Path) -> Finding:
    """Judge whether Numba's cache is writable: NUMBA_CACHE_DIR if set, else the package's or the user's folder."""
    if given:
        if writable(Path(given)):
            return ok(f"is stored in {given}")
        return warning(
            f"NUMBA_CACHE_DIR={given} cannot be written to: every start compiles for about a minute.",
            f"install -d -o $USER {given}, or unset NUMBA_CACHE_DIR",
        )
    # Without NUMBA_CACHE_DIR Numba tries these two in this order.
    places = (package / "__pycache__", Path(os.environ.get("XDG_CACHE_HOME", home / ".cache")) / "numba")
    for place in places:
        if writable(place):
            return ok(f"is stored in {place}")
    return warning(
        f"neither {places[0]} nor {places[1]} can be written to: every start compiles for about a minute.",
        "Set NUMBA_CACHE_DIR to a directory of this user, as deploy/vaoi-station.service does.",
    )
