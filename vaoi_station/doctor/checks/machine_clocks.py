"""The machine's clocks: the wall's, which names runs, and the monotonic one, on which everything is measured."""

from __future__ import annotations

import ctypes
import struct
import time
from collections.abc import Iterator

from vaoi_station.doctor.finding import Figures, Finding, not_applicable, ok, warning
from vaoi_station.doctor.machine import Machine

TIME_ERROR = 5
"""Return value of adjtimex: nobody keeps the clock in step."""
_MAX_ERROR_AT, _SIZE = 24, 256
"""Place of `maxerror` in struct timex of 64-bit Linux; more than its size."""
COARSE_S = 1e-6
GOOD_SOURCES = {"tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "arm,sp804", "riscv_clocksource"}


def wall_clock(_: Machine) -> Iterator[Finding]:
    """Is the wall clock kept in step by somebody (NTP, PTP)? Asked of the kernel, which nothing changes."""
    buffer = ctypes.create_string_buffer(_SIZE)  # modes = 0: only look
    state = ctypes.CDLL(None, use_errno=True).adjtimex(buffer)
    (max_error_us,) = struct.unpack_from("<q", buffer.raw, _MAX_ERROR_AT)
    yield judge_wall_clock(state, max_error_us)


def judge_wall_clock(state: int, max_error_us: int) -> Finding:
    """What adjtimex said."""
    if state < 0:
        return not_applicable("the kernel does not tell whether the clock is kept in step")
    if state == TIME_ERROR:
        return warning(
            "nobody keeps the wall clock in step: names and times of runs drift away from those of other machines.",
            "timedatectl set-ntp true",
            figures={"synchronised": False},
        )
    return ok(
        f"kept in step, off by {max_error_us / 1e3:.0f} ms at most",
        figures={"synchronised": True, "max_error_ms": round(max_error_us / 1e3, 3)},
    )


def monotonic_clock(machine: Machine) -> Iterator[Finding]:
    """The clock on which frames find their pulses."""
    source = machine.text("sys/devices/system/clocksource/clocksource0/current_clocksource")
    yield judge_monotonic(time.get_clock_info("monotonic").resolution, source)


def judge_monotonic(resolution_s: float, source: str | None) -> Finding:
    """Fine enough, and cheap to read?"""
    figures: Figures = {"resolution_us": resolution_s * 1e6, "source": source}
    if resolution_s > COARSE_S:
        return warning(
            f"has steps of {resolution_s * 1e6:g} µs; frames are matched to fractions of a millisecond.",
            "Boot without highres=off.",
            figures=figures,
        )
    if source is not None and source not in GOOD_SOURCES:
        return warning(
            f"comes from {source}, which is slow to read.",
            "Look for clocksource in the kernel's log (journalctl -k -g clocksource); boot without clocksource=.",
            figures=figures,
        )
    return ok(f"steps of {resolution_s * 1e9:g} ns" + (f", from {source}" if source else ""), figures=figures)
