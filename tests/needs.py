"""Requirements of tests on the machine.

In CI a missing requirement is a failure; elsewhere the test is skipped, and the reason names what to install.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

from vaoi_station.acquisition.cameras.aravis.library import aravis
from vaoi_station.errors import DeviceError


def is_yes(setting: str) -> bool:
    """Return whether an environment variable is set to a value other than 0, false, no or off."""
    return setting.strip().lower() not in {"", "0", "false", "no", "off"}


VERDICT = is_yes(os.environ.get("CI", ""))
"""True in CI, where a test must not be skipped for a missing requirement."""
LONG = is_yes(os.environ.get("VAOI_LONG", ""))
"""Whether fuzzers, repetitions and property tests run at full length; the suite has a short form of each."""
FILMS = Path(__file__).resolve().parents[2] / "shared" / "cases"
"""Directory beside the checkout: `make.py` renders a recorded case, `score.py` compares a result with its truth."""
DESCRIPTIONS = FILMS.with_name("cameras")
"""Directory beside the checkout: GenICam descriptions of real cameras, compressed."""
_PACKAGES = {
    "avr-gcc": "gcc-avr avr-libc",
    "cc": "gcc",
    "System.Net.Http.dll": "libmono-system-net-http4.0-cil",
    "System.Runtime.Serialization.dll": "libmono-system-runtime-serialization4.0-cil",
    "chromium-headless-shell": "chromium-headless-shell",
    "curl": "curl",
    "curl/curl.h": "libcurl4-openssl-dev",
    "gcc": "gcc",
    "make": "make",
    "mcs": "mono-mcs",
    "mono": "mono-runtime",
    "mosquitto": "mosquitto",
    "nginx": "nginx-light",
    "prometheus": "prometheus",
    "promtool": "prometheus",
    "simavr/sim_avr.h": "libsimavr-dev libelf-dev",
    "systemd-analyze": "systemd",
}
"""Packages of the distribution, by the program, header or assembly that they provide."""


def lacking(what: str) -> NoReturn:
    """Skip the test, or fail it in CI."""
    if VERDICT:
        pytest.fail(what)
    pytest.skip(f"platform: {what}")


def need(*wanted: str) -> None:
    """Require programs, headers and assemblies."""
    missing = [_PACKAGES[name] for name in wanted if not _is_there(name)]
    if missing:
        lacking(f"install the distribution's packages {' '.join(missing)}")


def need_emulator() -> None:
    """Require the tools that build the firmware and the emulated chip."""
    need("avr-gcc", "make", "gcc", "simavr/sim_avr.h")


def need_aravis() -> None:
    """Require Aravis, and PyGObject for this Python."""
    try:
        aravis()
    except DeviceError as refusal:
        lacking(str(refusal))


def need_films() -> None:
    """Require the programs that render the recorded cases and score their results."""
    if not (FILMS / "make.py").is_file():
        lacking(f"the recorded cases are not beside this checkout, in {FILMS}")


def need_referee() -> None:
    """Require the reference implementation of GenApi."""
    if importlib.util.find_spec("genicam") is None:
        lacking("install genicam, with the versions of constraints.txt")


def need_descriptions() -> None:
    """Require the descriptions of real cameras."""
    if not DESCRIPTIONS.is_dir():
        lacking(f"the descriptions of cameras are not beside this checkout, in {DESCRIPTIONS}")


def chromium() -> str:
    """Return the path of the distribution's browser; playwright's own would have to be downloaded."""
    # Without its own windows and menus it needs half the computing time; the whole browser serves as well.
    path = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    if path is None:
        need("chromium-headless-shell")
    assert path is not None
    return path


def _is_there(name: str) -> bool:
    if name.endswith(".h"):
        return any(Path("/usr/include").glob(f"**/{name}"))
    if name.endswith(".dll"):
        return any(Path("/usr/lib/mono").glob(f"*/{name}"))
    return program(name) is not None


def program(name: str) -> str | None:
    """Return the path of a program, also of one for administrators; None if it is absent."""
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
