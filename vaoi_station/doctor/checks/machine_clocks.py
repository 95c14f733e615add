"""Check the machine's clocks: the wall clock, by which runs are named, and the monotonic clock, for all other times."""

from __future__ import annotations

import ctypes
import struct
import time
from collections.abc import Iterator

from vaoi_station.doctor.finding import Figures, Finding, not_applicable, ok, warning
from vaoi_station.doctor.machine import Machine

TIME_ERROR = 5
"""Return value of adjtimex (TIME_ERROR): the clock is not synchronised."""
_MAX_ERROR_AT, _SIZE = 24, 256
"""Byte offset of `maxerror` in struct timex of 64-bit Linux; and a buffer size that is larger than this struct."""
COARSE_S = 1e-6
GOOD_SOURCES = {"tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "arm,sp804", "riscv_clocksource"}


def wall_clock(_: Machine) -> Iterator[Finding]:
    """Check that the machine's wall clock is synchronised by NTP or PTP."""
    # `modes` is the first field of the struct. Zero makes adjtimex read only, which needs no privilege.
    buffer = ctypes.create_string_buffer(_SIZE)
    state = ctypes.CDLL(None, use_errno=True).adjtimex(buffer)
    (max_error_us,) = struct.unpack_from("<q", buffer.raw, _MAX_ERROR_AT)
    yield judge_wall_clock(state, max_error_us)


def judge_wall_clock(state: int, max_error_us: int) -> Finding:
    """Judge what the system call adjtimex returns: the state of the wall clock, and the bound of its error."""
    if state < 0:
        return not_applicable("the kernel does not report whether the wall clock is synchronised")
    if state == TIME_ERROR:
        return warning(
            "the wall clock is not synchronised: names and times of runs drift away from those of other machines.",
            "timedatectl set-ntp true",
            figures={"synchronised": False},
            code="wall-clock-free",
        )
    return ok(
        f"synchronised, error at most {max_error_us / 1e3:.0f} ms",
        figures={"synchronised": True, "max_error_ms": round(max_error_us / 1e3, 3)},
    )


def monotonic_clock(machine: Machine) -> Iterator[Finding]:
    """Check the monotonic clock, by which frames are assigned to pulses."""
    source = machine.text("sys/devices/system/clocksource/clocksource0/current_clocksource")
    yield judge_monotonic(time.get_clock_info("monotonic").resolution, source)


def judge_monotonic(resolution_s: float, source: str | None) -> Finding:
    """Judge the resolution of the monotonic clock, and its source: the hardware that the kernel reads for it."""
    figures: Figures = {"resolution_us": resolution_s * 1e6, "source": source}
    if resolution_s > COARSE_S:
        return warning(
            f"has steps of {resolution_s * 1e6:g} µs, more than {COARSE_S * 1e6:g}; frames are assigned to pulses to "
            "fractions of a millisecond.",
            "Remove highres=off from the kernel's command line.",
            figures=figures,
            code="monotonic-clock-coarse",
        )
    # A source such as hpet or acpi_pm reads a device register each time, instead of a counter of the processor.
    if source is not None and source not in GOOD_SOURCES:
        return warning(
            f"comes from {source}, a source that is slow to read.",
            "Find the cause by journalctl -k -g clocksource; remove clocksource= from the kernel's command line.",
            figures=figures,
            code="monotonic-clock-slow",
        )
    return ok(f"steps of {resolution_s * 1e9:g} ns" + (f", from {source}" if source else ""), figures=figures)
