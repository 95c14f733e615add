"""What tests need of the machine they run on.

Where a verdict hangs on it, what is lacking is an error; at a desk the test is skipped and says what to install.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

from vaoi_station.acquisition.cameras.aravis.library import aravis
from vaoi_station.errors import DeviceError


def is_yes(setting: str) -> bool:
    """Whether a variable of the environment is set, and not to what means no."""
    return setting.strip().lower() not in {"", "0", "false", "no", "off"}


VERDICT = is_yes(os.environ.get("CI", ""))
"""Whether a verdict hangs on this session."""
FILMS = Path(__file__).resolve().parents[2] / "shared" / "cases"
"""Beside the checkout: `make.py` films a case, `score.py` compares a result with the truth."""
_PACKAGES = {
    "avr-gcc": "gcc-avr avr-libc",
    "cc": "gcc",
    "chromium": "chromium",
    "curl": "curl",
    "curl/curl.h": "libcurl4-openssl-dev",
    "gcc": "gcc",
    "make": "make",
    "simavr/sim_avr.h": "libsimavr-dev libelf-dev",
}
"""The distribution's, by the program or the header that is looked for."""


def lacking(what: str) -> NoReturn:
    """Leave the test out, or let it fail where a verdict hangs on it."""
    if VERDICT:
        pytest.fail(what)
    pytest.skip(f"platform: {what}")


def need(*wanted: str) -> None:
    """Programs and headers."""
    missing = [_PACKAGES[name] for name in wanted if not _is_there(name)]
    if missing:
        lacking(f"install the distribution's packages {' '.join(missing)}")


def need_emulator() -> None:
    """What the firmware and the chip that it runs on are built with."""
    need("avr-gcc", "make", "gcc", "simavr/sim_avr.h")


def need_aravis() -> None:
    """Aravis, and a PyGObject for this Python."""
    try:
        aravis()
    except DeviceError as refusal:
        lacking(str(refusal))


def need_films() -> None:
    """The programs that film the recorded cases and score what is made of them."""
    if not (FILMS / "make.py").is_file():
        lacking(f"the recorded cases are not beside this checkout, in {FILMS}")


def chromium() -> str:
    """Path of the distribution's browser; playwright's own would have to be downloaded."""
    need("chromium")
    path = shutil.which("chromium")
    assert path is not None
    return path


def _is_there(name: str) -> bool:
    if name.endswith(".h"):
        return any(Path("/usr/include").glob(f"**/{name}"))
    return shutil.which(name) is not None
