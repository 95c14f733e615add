"""Check the kernel's socket buffers, which hold camera packets until the acquisition process reads them."""

from __future__ import annotations

import math
from collections.abc import Iterator

from vaoi_station.acquisition.cameras.aravis.opening import socket_bytes
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import format_bytes


def socket_buffers(context: CheckContext) -> Iterator[Finding]:
    """Check net.core.rmem_max, the upper limit of a socket's receive buffer."""
    if not context.real_cameras:
        yield not_applicable("no camera is on the network")
        return
    # The kernel reduces a larger request to this limit and reports no error.
    yield judge_buffers(
        context.machine.sysctl("net.core.rmem_max"),
        max(socket_bytes(camera, context.config.line.shortest_period_s) for camera in context.real_cameras),
    )


def judge_buffers(granted: int | None, needed: int) -> Finding:
    """Judge whether a socket buffer of the permitted size holds the data that one camera sends in one second."""
    figures: Figures = {"rmem_max_bytes": granted, "needed_bytes": needed}
    if granted is None:
        return fault(
            "net.core.rmem_max cannot be read.",
            "Run sysctl net.core.rmem_max and correct what it reports.",
            figures=figures,
            code="socket-buffer-unknown",
        )
    if granted < needed:
        return warning(
            f"net.core.rmem_max is {format_bytes(granted)}, but a camera sends {format_bytes(needed)} in a second: "
            "frames are lost when the machine stalls.",
            f"sysctl -w net.core.rmem_max={2 ** math.ceil(math.log2(needed))}; permanently: "
            "install -m 644 deploy/60-vaoi.conf /etc/sysctl.d/",
            figures=figures,
            code="socket-buffer-small",
        )
    return ok(f"net.core.rmem_max is {format_bytes(granted)}, {format_bytes(needed)} are needed", figures=figures)
