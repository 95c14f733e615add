"""Check the kernel's memory limit for USB transfers."""

from __future__ import annotations

from collections.abc import Iterator

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok

PER_CAMERA_MB = 8
"""Memory that Aravis submits at a time for each USB camera (ARV_UV_STREAM_MAXIMUM_SUBMIT_TOTAL)."""
PARAMETER = "sys/module/usbcore/parameters/usbfs_memory_mb"


def memory(context: CheckContext) -> Iterator[Finding]:
    """Check usbfs_memory_mb: the kernel's limit must be enough for all cameras that may be connected by USB."""
    # Only a camera named by its serial number can be on USB: an address is always that of a GigE camera.
    named = sum(camera.serial is not None for camera in context.real_cameras)
    if not named:
        yield not_applicable("no camera is named by a serial number, as USB cameras are")
        return
    yield judge_memory(context.machine.number(PARAMETER), named)


def judge_memory(granted_mb: int | None, cameras: int) -> Finding:
    """Judge whether the limit in MB suffices for this number of cameras. A limit of 0 means that there is no limit."""
    needed_mb = PER_CAMERA_MB * cameras
    figures: Figures = {"usbfs_memory_mb": granted_mb, "needed_mb": needed_mb}
    if granted_mb is None:
        return not_applicable("this machine has no USB")
    if 0 < granted_mb < needed_mb:
        return fault(
            f"usbfs_memory_mb is {granted_mb}, {cameras} cameras on USB need {needed_mb}: the last ones do not start.",
            "echo 256 > /sys/module/usbcore/parameters/usbfs_memory_mb; permanently: "
            "install -m 644 deploy/vaoi-usb-memory.conf /etc/tmpfiles.d/",
            figures=figures,
            code="usb-memory-small",
        )
    return ok(f"usbfs_memory_mb is {granted_mb or 'without limit'}, {needed_mb} are needed", figures=figures)
