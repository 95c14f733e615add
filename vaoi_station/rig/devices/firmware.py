"""Build the controller's firmware and the emulator from their C sources.

The sources are `hw/firmware` and `hw/virtual_rig` of a checkout; the wheel has a copy of them beside this package.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.version import __version__

_HERE = Path(__file__).resolve()
PACKAGED = _HERE.parents[1] / "hardware" / "firmware"
"""Where the wheel puts the sources; see `force-include` in pyproject.toml."""
CHECKOUT = _HERE.parents[3] / "hw" / "firmware"
_TOOLS = {"make": "make", "gcc": "gcc", "avr-gcc": "gcc-avr avr-libc"}
"""Program → the distribution's packages that contain it."""


def find_sources() -> Path:
    """Return the folder of the firmware's Makefile.

    Raises:
        NotFoundError: there are no sources, neither in the package nor in a checkout.
    """
    # The package comes first: beside an installed package a folder `hw` would belong to another project.
    for folder in (PACKAGED, CHECKOUT):
        if (folder / "Makefile").is_file():
            return folder
    raise NotFoundError(
        f"the rig runs the real firmware, but its sources are neither in {PACKAGED} nor in {CHECKOUT}.",
        action=f"Install version {__version__} again from its wheel, or run it from a checkout.",
    )


def check_sources() -> None:
    """Check that the firmware can be built here, before minutes are spent on rendering boards.

    Raises:
        NotFoundError: the sources are missing.
        DeviceError: a build tool is missing.
    """
    find_sources()
    if missing := [packages for tool, packages in _TOOLS.items() if shutil.which(tool) is None]:
        action = f"Install the distribution's packages {' '.join(missing)} libsimavr-dev libelf-dev."
        raise DeviceError("the firmware cannot be built here.", action=action)


def build(folder: Path) -> Path:
    """Build firmware and emulator into a folder; the sources' own folder is only read.

    Returns:
        The folder, with `firmware.elf` and `emulator`.

    Raises:
        NotFoundError, DeviceError: see `check_sources`; or the build fails, and the message has the compiler's output.
    """
    check_sources()
    sources = find_sources()
    command = ["make", "-C", str(sources), f"BUILD={folder.resolve()}", "all", "emulator"]
    if sources == PACKAGED:
        # The Makefile asks git for the commit. In site-packages git might answer with that of an unrelated repository.
        command.append("COMMIT=")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceError(f"the firmware does not build: {(done.stderr or done.stdout).strip()[-1000:]}")
    return folder
