"""Check the camera library Aravis, and PyGObject, through which Python calls it."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from vaoi_station.acquisition.cameras.aravis import library
from vaoi_station.acquisition.cameras.aravis.connection import USB3_MIN_VERSION
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.errors import DeviceError


def aravis(context: CheckContext) -> Iterator[Finding]:
    """Check that PyGObject and Aravis can be imported, and their versions."""
    if not context.real_cameras:
        yield not_applicable("no camera uses Aravis")
        return
    try:
        library.aravis()
        found = library.version()
    except DeviceError as error:
        yield fault(error.message, error.action, code=error.code)
        return
    gi = str(sys.modules["gi"].__version__)
    yield judge_version(found, gi, sum(camera.serial is not None for camera in context.real_cameras))


def judge_version(found: tuple[int, int, int], gi: str, perhaps_usb: int) -> Finding:
    """Judge the version of Aravis. Every version supports GigE cameras; USB3 cameras need 0.8.30 or later."""
    shown = ".".join(map(str, found))
    figures: Figures = {"aravis": shown, "pygobject": gi}
    message = f"Aravis {shown}, PyGObject {gi}"
    # Aravis 0.8.28 made USB transfers asynchronous, 0.8.29 corrected their callbacks and underruns, and 0.8.30 sets
    # the status of a buffer before it is pushed. Only a camera named by its serial number can be on USB.
    if perhaps_usb and found < USB3_MIN_VERSION:
        return warning(
            f"{message}: unreliable with USB3 cameras; {perhaps_usb} of the cameras may be on USB.",
            "Name GigE cameras by their address; for USB3 use a distribution with Aravis 0.8.30 or later (Debian 13).",
            figures=figures,
            code="aravis-old",
        )
    return ok(message, figures=figures)
