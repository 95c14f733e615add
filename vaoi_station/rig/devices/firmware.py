"""Build the controller's firmware and the emulator from their C sources.

The sources are in `hw/firmware` and `hw/virtual_rig` of a checkout; the wheel contains a copy of these folders.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.version import __version__

_HERE = Path(__file__).resolve()
PACKAGED = _HERE.parents[1] / "hardware" / "firmware"
"""Folder of the firmware's sources in an installed package; see `force-include` in pyproject.toml."""
CHECKOUT = _HERE.parents[3] / "hw" / "firmware"
_TOOLS = {"make": "make", "gcc": "gcc", "avr-gcc": "gcc-avr avr-libc"}
"""Build tool → the packages of the Linux distribution that contain it."""


def find_sources() -> Path:
    """Return the folder with the firmware's Makefile, in the installed package or in the checkout.

    Raises:
        NotFoundError: neither has the sources.
    """
    # PACKAGED comes first: for an installed package, the folder at CHECKOUT may belong to another project.
    for folder in (PACKAGED, CHECKOUT):
        if (folder / "Makefile").is_file():
            return folder
    raise NotFoundError(
        f"the rig runs the real firmware, but its sources are neither in {PACKAGED} nor in {CHECKOUT}.",
        action=f"Install version {__version__} again from its wheel, or run it from a checkout.",
    )


def check_sources() -> None:
    """Check that this computer can build the firmware. Called first, because rendering boards takes minutes.

    Raises:
        NotFoundError: the sources are missing.
        DeviceError: a build tool is missing.
    """
    find_sources()
    if missing := [packages for tool, packages in _TOOLS.items() if shutil.which(tool) is None]:
        action = f"Install the distribution's packages {' '.join(missing)} libsimavr-dev libelf-dev."
        raise DeviceError("the firmware cannot be built here.", action=action)


def build(folder: Path) -> Path:
    """Build the firmware and the emulator into a folder. The folder of the sources is not written.

    Returns:
        The given folder, which then contains `firmware.elf` and `emulator`.

    Raises:
        NotFoundError: the sources are missing.
        DeviceError: a build tool is missing, or the build fails; the message has the compiler's output.
    """
    check_sources()
    sources = find_sources()
    command = ["make", "-C", str(sources), f"BUILD={folder.resolve()}", "all", "emulator"]
    if sources == PACKAGED:
        # The Makefile asks git for the commit. For a package inside another repository, git would give a wrong commit.
        command.append("COMMIT=")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceError(f"the firmware does not build: {(done.stderr or done.stdout).strip()[-1000:]}")
    return folder
