"""Check the Python interpreter, the libraries, and the cache for compiled code."""

from __future__ import annotations

import importlib
import os
import platform
import pwd
import re
import stat
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vaoi_station import version
from vaoi_station.doctor.finding import Finding, fault, ok, warning
from vaoi_station.doctor.machine import Machine, writable

OLDEST, FIRST_UNTRIED = (3, 11), (3, 14)
LIBRARIES = {"numpy": "numpy", "numba": "numba", "cv2": "opencv-python-headless", "pydantic": "pydantic"}
UNIT = "vaoi-station.service"
PACKAGE = Path(version.__file__).parent


def python(_: Machine) -> Iterator[Finding]:
    """Check the Python interpreter that runs this command. The station uses the same one."""
    yield judge_python(sys.version_info[:2], 8 * struct.calcsize("P"), platform.python_version(), sys.executable)


def judge_python(version: tuple[int, int], bits: int, shown: str, where: str) -> Finding:
    """Judge the version of a Python interpreter, and whether it is a 64-bit program."""
    message = f"Python {shown}, {bits} bit, {where}"
    if bits < 64:
        return fault(
            f"{message}: the ring needs more address space than 32 bit offer.",
            "Install a 64-bit system.",
            code="python-32-bit",
        )
    if not OLDEST <= version < FIRST_UNTRIED:
        return fault(
            f"{message}: vaoi_station needs Python 3.11 to 3.13.",
            "python3.11 -m venv .venv && .venv/bin/pip install .",
            code="python-untried",
        )
    return ok(message, figures={"python": shown})


def libraries(_: Machine) -> Iterator[Finding]:
    """Check that the required libraries can be imported."""
    versions = {}
    for name, package in LIBRARIES.items():
        try:
            versions[name] = str(importlib.import_module(name).__version__)
        except ImportError as error:
            yield fault(
                f"{name} cannot be imported: {error}.",
                f"{sys.executable} -m pip install {package}",
                code="library-absent",
                figures={"library": package},
            )
    if len(versions) == len(LIBRARIES):
        yield ok(", ".join(f"{name} {version}" for name, version in versions.items()), figures=versions)


def compiled_code_cache(machine: Machine) -> Iterator[Finding]:
    """Check that Numba can store compiled inner loops, where the service does it: by its unit, as its user."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    unit = _unit_of_this_installation(machine)
    if given is None and unit is not None and unit.cache is not None:
        yield judge_cache_of_service(unit)
    else:
        yield judge_cache(given, PACKAGE, Path.home())


class ServiceUnit(NamedTuple):
    """The user and the cache directory that the systemd unit of the station states."""

    user: str
    cache: Path | None


def _unit_of_this_installation(machine: Machine) -> ServiceUnit | None:
    """Read the unit that runs the station of this environment; None if there is no such unit."""
    for place in ("etc/systemd/system", "usr/local/lib/systemd/system", "usr/lib/systemd/system"):
        text = machine.text(f"{place}/{UNIT}")
        if text is None:
            continue
        values = dict(re.findall(r"(?m)^(ExecStart|User)=(.*)$", text))
        if not values.get("ExecStart", "").startswith(f"{sys.prefix}/"):
            return None
        cache = re.search(r"(?m)^Environment=\"?NUMBA_CACHE_DIR=([^\"\n]+)", text)
        return ServiceUnit(values.get("User", "root").strip(), Path(cache[1].strip()) if cache else None)
    return None


def judge_cache_of_service(unit: ServiceUnit) -> Finding:
    """Judge whether the cache that the unit names is writable for the user of the service, not of the doctor."""
    assert unit.cache is not None
    action = f"install -d -o {unit.user} -g {unit.user} -m 750 {unit.cache}"
    try:
        user = pwd.getpwnam(unit.user)
    except KeyError:
        return fault(
            f"the user {unit.user} of the service does not exist.",
            f"useradd --system {unit.user}",
            code="service-user-absent",
            figures={"user": unit.user},
        )
    try:
        status = unit.cache.stat()
    except FileNotFoundError:
        # CacheDirectory= of the unit makes it at the next start, with the right owner.
        return ok(f"will be stored in {unit.cache} by the service")
    except OSError as error:
        return warning(
            f"{unit.cache}, the cache of the service, cannot be examined ({error.strerror}).",
            action,
            code="code-cache-unusable",
            figures={"path": str(unit.cache)},
        )
    groups = os.getgrouplist(unit.user, user.pw_gid)
    mode = status.st_mode >> (6 if status.st_uid == user.pw_uid else 3 if status.st_gid in groups else 0)
    if stat.S_ISDIR(status.st_mode) and (mode & 0o3 == 0o3 or user.pw_uid == 0):
        return ok(f"is stored in {unit.cache} by the service")
    return warning(
        f"{unit.cache} cannot be written to by {unit.user}, the user of the service: every start compiles for about a "
        "minute.",
        action,
        code="code-cache-unusable",
        figures={"path": str(unit.cache)},
    )


def judge_cache(given: str | None, package: Path, home: Path) -> Finding:
    """Judge whether Numba's cache is writable: NUMBA_CACHE_DIR if set, else the package's or the user's folder."""
    if given:
        if writable(Path(given)):
            return ok(f"is stored in {given}")
        return warning(
            f"NUMBA_CACHE_DIR={given} cannot be written to: every start compiles for about a minute.",
            f"install -d -o $USER {given}, or unset NUMBA_CACHE_DIR",
            code="code-cache-unusable",
            figures={"path": given},
        )
    # Without NUMBA_CACHE_DIR Numba tries these two in this order.
    places = (package / "__pycache__", Path(os.environ.get("XDG_CACHE_HOME", home / ".cache")) / "numba")
    for place in places:
        if writable(place):
            return ok(f"is stored in {place}")
    return warning(
        f"neither {places[0]} nor {places[1]} can be written to: every start compiles for about a minute.",
        "Set NUMBA_CACHE_DIR to a directory of this user, as deploy/vaoi-station.service does.",
        code="code-cache-unusable",
        figures={"path": str(places[1])},
    )
