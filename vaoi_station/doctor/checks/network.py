"""What the kernel holds of the cameras' packets while nobody looks."""

from __future__ import annotations

import math
from collections.abc import Iterator

from vaoi_station.acquisition.cameras.aravis.opening import socket_bytes
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import format_bytes


def socket_buffers(context: CheckContext) -> Iterator[Finding]:
    """net.core.rmem_max, which silently cuts what a socket asks for."""
    if not context.real_cameras:
        yield not_applicable("no camera is on the network")
        return
    yield judge_buffers(
        context.machine.sysctl("net.core.rmem_max"),
        max(socket_bytes(camera, context.config.line.trigger_period_s) for camera in context.real_cameras),
    )


def judge_buffers(granted: int | None, needed: int) -> Finding:
    """Enough for a second of stall?"""
    figures: Figures = {"rmem_max_bytes": granted, "needed_bytes": needed}
    if granted is None:
        return fault("net.core.rmem_max cannot be read.", "sysctl net.core.rmem_max", figures=figures)
    if granted < needed:
        return warning(
            f"net.core.rmem_max is {format_bytes(granted)}, but a camera sends {format_bytes(needed)} in a second: "
            "a stall of the machine loses frames.",
            f"sysctl -w net.core.rmem_max={2 ** math.ceil(math.log2(needed))}; for good: "
            "install -m 644 deploy/60-vaoi.conf /etc/sysctl.d/",
            figures=figures,
        )
    return ok(f"net.core.rmem_max is {format_bytes(granted)}, {format_bytes(needed)} are needed", figures=figures)
