"""The library that drives the cameras, and what binds Python to it."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from vaoi_station.acquisition.cameras.aravis import library
from vaoi_station.acquisition.cameras.aravis.connection import USB3_MIN_VERSION
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.errors import DeviceError


def aravis(context: CheckContext) -> Iterator[Finding]:
    """PyGObject for this Python, and Aravis by it."""
    if not context.real_cameras:
        yield not_applicable("no camera needs it")
        return
    try:
        library.aravis()
        found = library.version()
    except DeviceError as error:
        yield fault(error.message, error.action)
        return
    gi = str(sys.modules["gi"].__version__)
    yield judge_version(found, gi, sum(camera.serial is not None for camera in context.real_cameras))


def judge_version(found: tuple[int, int, int], gi: str, perhaps_usb: int) -> Finding:
    """Good for GigE in every version, for USB from 0.8.30 on."""
    shown = ".".join(map(str, found))
    figures: Figures = {"aravis": shown, "pygobject": gi}
    told = f"Aravis {shown}, PyGObject {gi}"
    if perhaps_usb and found < USB3_MIN_VERSION:
        return warning(
            f"{told}: unreliable with USB3 cameras; {perhaps_usb} of the cameras may be on USB.",
            "Name GigE cameras by their address; for USB3 use a distribution with Aravis 0.8.30 or later (Debian 13).",
            figures=figures,
        )
    return ok(told, figures=figures)
