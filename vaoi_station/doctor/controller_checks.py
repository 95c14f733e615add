"""Check the controller: port, firmware, limits, state and clock.

Only the requests IDENT, STATUS, CLOCK and READ_EVENT are sent, which change nothing in the controller. Opening the port
resets some controller boards (hw/wiring.md); without a running station, this does no harm. With a running station, the
state is read from its REST service instead.
"""

from __future__ import annotations

import grp
import os
import stat
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.controller.protocol import (
    HEARTBEAT_S,
    PERMIT_TEST,
    TICK_S,
    ClockReply,
    Fault,
    Hold,
    Ident,
    Link,
    Request,
    State,
    Status,
    Type,
    check_contacts,
    check_ident,
    check_interlock,
    number_request,
    ready,
)
from vaoi_station.acquisition.controller.serial.controller import BACKWARDS_COUNTS
from vaoi_station.acquisition.controller.serial.device_program import make_program
from vaoi_station.acquisition.controller.serial.exchange import Exchange, Port, Timebase, Waker
from vaoi_station.acquisition.process.session import CLOCK_LIMIT_S, CLOCK_SHARE
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.doctor.finding import Figures, Finding, Level, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.line_config import Line

SPEED_SHARE = 0.1
"""Difference of the belt's speed by the encoder from the nominal one, from which on it is reported."""
_WRAP = 1 << 32
READINGS = 20
"""Number of clock readings. The best of them limits the error of the clock model."""
LATENCY = "sys/bus/usb-serial/devices/{name}/latency_timer"
"""File that contains the time, ms, for which a USB bridge of FTDI collects bytes before it sends them."""


@dataclass(frozen=True)
class ControllerReply:
    """The replies of the controller to `vaoi doctor`: identity, status and clock readings."""

    ident: Ident
    status: Status
    readings: tuple[ClockReading, ...]
    first: Status
    """The status before the clock readings: the belt may have moved since."""


def controller(context: CheckContext) -> Iterator[Finding]:
    """Check the controller's port, firmware, limits, state and clock. Stop at the first of them that cannot be read."""
    if context.running is not None:
        yield of_running_station(context)
        return
    if context.config.controller.backend != "serial":
        yield not_applicable(f"backend {context.config.controller.backend!r}: there is no serial port")
        return
    settings = context.config.controller
    port = judge_port(Path(settings.port), context.machine)
    yield port
    if port.level is Level.FAULT:
        return
    yield from judge_latency(Path(settings.port), context.machine)
    try:
        reply = ask(settings)
    except DeviceError as error:
        yield fault(error.code, error.message, error.action, "firmware")
        return
    yield judge_firmware(reply.ident)
    yield judge_limits(reply.ident, context.config)
    if settings.interlock == "on":
        yield judge_interlock(reply.ident)
    if context.config.smema is not None:
        yield judge_contacts(reply.ident, reply.status)
    if context.config.line.by_encoder:
        yield judge_encoder(reply, context.config.line)
    yield judge_status(reply.status)
    yield judge_clock(reply.readings, context.config.line.trigger_period_s)


def of_running_station(context: CheckContext) -> Finding:
    """Report the controller's state as the running station states it; the check `station` reports its problems."""
    assert context.running is not None
    if not context.running.snapshot:
        return warning(
            "controller-unreported",
            "another process uses the controller and does not report its state; its port was not opened.",
            f"{context.running.inspect_command}; end it, and run vaoi doctor again",
        )
    return ok(str(context.running.snapshot.get("controller") or "the station has no state of it yet"))


def ask(settings: ControllerConfig) -> ControllerReply:
    """Read identity, status and clock readings; DeviceError if the controller does not reply as expected."""
    with closing(Waker()) as waker, closing(Port(settings.port, settings.baud, waker)) as port:
        exchange = Exchange(port, Link(), lambda _news, _heard_s: None, settings.port)
        ident = check_ident(exchange.identify())
        first = _status(exchange)
        # Else the link would read all earlier events, between the readings of the clock, and acknowledge them.
        exchange.link.skip_history()
        timebase = Timebase(settings.baud)
        readings = tuple(_reading(exchange, timebase, nonce) for nonce in range(READINGS))
        return ControllerReply(ident, _status(exchange), readings, first)


def _status(exchange: Exchange) -> Status:
    return Status.unpack(exchange.request(Request(Type.STATUS)).payload)


def _reading(exchange: Exchange, timebase: Timebase, nonce: int) -> ClockReading:
    replied = exchange.request(number_request(Type.CLOCK, nonce))
    return timebase.add_reply(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)


def judge_port(port: Path, machine: Machine) -> Finding:
    """Check that the port exists, is a serial port, may be opened by this user, and is not in use."""
    try:
        found = port.stat()
    except OSError:
        there = sorted(p.name for p in (machine.root / "dev/serial/by-id").glob("*"))
        action = (
            "Connect the controller; deploy/71-vaoi-controller.rules in /etc/udev/rules.d/ gives the port its name."
        )
        message = f"there is no {port}; serial devices present: {', '.join(there) or 'none'}."
        return fault("port-absent", message, action, "port", path=str(port))
    if not stat.S_ISCHR(found.st_mode) or not machine.is_terminal(found.st_rdev):
        return fault(
            "port-unusable", f"{port} is no serial port.", "Correct `port` under [controller].", "port", path=str(port)
        )
    if not os.access(port, os.R_OK | os.W_OK, effective_ids=True):
        group = _group(found.st_gid)
        message = f"{port} may not be read and written by this user (group {group}, {stat.filemode(found.st_mode)})."
        return fault(
            "port-forbidden",
            message,
            f"usermod -aG {group} vaoi, then restart the service",
            "port",
            path=str(port),
            group=group,
        )
    if holders := [h for h in machine.holders(port) if h.pid != os.getpid()]:
        shown = ", ".join(f"{h.name} (process {h.pid})" for h in holders)
        return fault(
            "port-in-use",
            f"{port} is in use by {shown}.",
            f"End it: kill {holders[0].pid}",
            "port",
            path=str(port),
            process=holders[0].pid,
        )
    return ok(f"{port} → {port.resolve()}, free" if port.is_symlink() else f"{port}, free", "port")


def judge_latency(port: Path, machine: Machine) -> Iterator[Finding]:
    """Warn if the USB-to-serial bridge delays bytes, because clock readings of the controller are then less exact."""
    kept_ms = machine.number(LATENCY.format(name=port.resolve().name))
    if kept_ms is not None and kept_ms > 1:
        yield warning(
            "usb-bridge-slow",
            f"the USB bridge delays bytes by up to {kept_ms} ms (limit: 1 ms), which makes the clock fit less exact.",
            f"echo 1 > /{LATENCY.format(name=port.resolve().name)}; permanently: deploy/71-vaoi-controller.rules",
            "port",
            latency_timer_ms=kept_ms,
        )


def judge_firmware(ident: Ident) -> Finding:
    """Report version, build and unit number of the firmware. `check_ident` has refused unsuitable firmware before."""
    version = f"{ident.firmware_major}.{ident.firmware_minor}.{ident.firmware_patch}"
    build = ident.build.rstrip(b"\0").decode("ascii", "replace")
    # An erased EEPROM cell reads as all ones: no unit number was ever written.
    unit = None if ident.unit == 0xFFFFFFFF else ident.unit
    figures: Figures = {"firmware": version, "build": build, "boots": ident.boots, "unit": unit}
    named = "no unit number" if unit is None else f"unit {unit}"
    message = f"version {version} ({build or 'no commit'}), protocol {ident.major}.{ident.minor}, {named}"
    return ok(f"{message}, start number {ident.boots}", "firmware", **figures)


def judge_limits(ident: Ident, config: StationConfig) -> Finding:
    """Judge whether the configured lights respect the pulse limits compiled into the firmware."""
    longest = (ident.led_longest_0, ident.led_longest_1, ident.led_longest_2, ident.led_longest_3)
    figures: Figures = {f"channel_{k}_longest_us": ticks * TICK_S * 1e6 for k, ticks in enumerate(longest)}
    try:
        make_program(filming_plan(config), config.controller, ident)
    except InputError as error:
        action = error.action or "Correct [controller] in station.toml, or the firmware's logic/pulses/limits.h."
        return fault("pulse-limits-exceeded", error.message, action, "limits", **figures)
    shown = ", ".join(f"{ticks * TICK_S * 1e6:g}" for ticks in longest[: ident.channels])
    message = f"longest pulses {shown} µs, lit at most 1/{1 << ident.led_duty_shift} of the time"
    lights = "the lights of station.toml respect them" if config.controller.lights else "no lights are configured"
    return ok(f"{message}; {lights}", "limits", **figures)


def judge_interlock(ident: Ident) -> Finding:
    """Check that the firmware has the output "line ready", which station.toml demands."""
    try:
        check_interlock(ident)
    except DeviceError as error:
        return fault(error.code, error.message, error.action, "interlock")
    message = f"the output 'line ready' falls at most {ident.ready_longest_ms} ms after the station is gone"
    return ok(message, "interlock", ready_longest_ms=ident.ready_longest_ms)


def judge_contacts(ident: Ident, status: Status) -> Finding:
    """Check that the firmware has the contacts of [smema], and report which of them are closed."""
    try:
        check_contacts(ident)
    except DeviceError as error:
        return fault(error.code, error.message, error.action, "contacts")
    closed = status.closed
    figures: Figures = {"available": closed.available, "failed": closed.failed, "next_ready": closed.next_ready}
    return ok(f"closed: {closed.closed}", "contacts", **figures)


def judge_status(status: Status) -> Finding:
    """Judge the controller's state, and report the light barrier."""
    state = State(status.state).name.lower() if status.state in set(State) else str(status.state)
    barrier = "interrupted" if status.blocked else "free"
    figures: Figures = {"state": state, "barrier": barrier, "bad_frames": status.bad_frames}
    message = f"{state}, the light barrier is {barrier}"
    if status.state == State.SAFE:
        reason = Fault(status.fault).name.lower() if status.fault in set(Fault) else str(status.fault)
        action = "Start the station, which disarms it."
        if status.fault == Fault.GUARD:
            action = f"An LED was on for too long: check LED drivers and wiring. {action}"
        return warning(
            "controller-safe", f"{message}; it has entered its safe state ({reason}).", action, "state", **figures
        )
    if status.state != State.IDLE:
        action = "End the program that armed it; the controller enters its safe state three seconds later."
        return warning("controller-armed", f"{message}, although no station runs here.", action, "state", **figures)
    return ok(message, "state", **figures)


def judge_encoder(reply: ControllerReply, line: Line) -> Finding:
    """Judge whether the encoder counts, forwards and as many counts as station.toml states for the belt's speed."""
    assert line.encoder is not None
    first, last = reply.first, reply.status
    counts = (last.position - first.position + _WRAP // 2) % _WRAP - _WRAP // 2
    took_s = (last.tick - first.tick) % _WRAP * TICK_S
    speed_mm_s = counts / took_s / line.encoder.counts_per_mm if took_s else 0.0
    figures: Figures = {"counts": counts, "seconds": round(took_s, 3), "mm_s": round(speed_mm_s, 2)}
    message = f"{counts} counts in {took_s:.2f} s, {speed_mm_s:.1f} mm/s by encoder.counts_per_mm"
    if counts < -BACKWARDS_COUNTS:
        action = "Exchange its channels A and B (hw/wiring.md), or check the direction of the belt."
        return fault("encoder-backwards", f"{message}: it counts backwards.", action, "encoder", **figures)
    if counts <= BACKWARDS_COUNTS:
        action = "Let the belt run and repeat vaoi doctor; if no count arrives then, check encoder, supply and cable."
        nothing = f"{message}: the belt is at rest, or it does not count."
        return warning("encoder-still", nothing, action, "encoder", **figures)
    if abs(speed_mm_s - line.speed_mm_s) > SPEED_SHARE * line.speed_mm_s:
        action = "Correct counts_per_mm under [line.encoder], or conveyor_mm_s; the belt may not have its speed yet."
        nominal = f"{message}, but conveyor_mm_s is {line.speed_mm_s:g} mm/s."
        return warning("encoder-speed", nominal, action, "encoder", **figures)
    return ok(message, "encoder", **figures)


def judge_clock(readings: Sequence[ClockReading], period_s: float) -> Finding:
    """Judge how exactly times of the controller's clock can be converted to times of the host's clock."""
    model = ClockModel("controller")
    for reading in readings:
        model.add(reading)
    bound_s, best_s = model.bound_s(readings[-1].device_s), min(2 * reading.bound_s for reading in readings)
    figures: Figures = {"bound_ms": round(bound_s * 1e3, 4), "round_trip_ms": round(best_s * 1e3, 4)}
    message = f"wrong by at most {bound_s * 1e3:.2f} ms after {len(readings)} readings"
    if bound_s > (limit_s := min(CLOCK_LIMIT_S, CLOCK_SHARE * period_s)):
        message = f"{message}, but the limit for this trigger period is {limit_s * 1e3:g} ms."
        action = "Connect it without a hub; install -m 644 deploy/71-vaoi-controller.rules /etc/udev/rules.d/."
        return fault("clock-unknown", message, action, "clock", **figures)
    return ok(message, "clock", **figures)


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


TIMES = 3
LEVEL_S = 4.0
"""Time for which each level lasts, s: long enough for a multimeter."""


def toggle_line_output(
    settings: ControllerConfig, show: Callable[[str], None], times: int = TIMES, level_s: float = LEVEL_S
) -> None:
    """Switch the output high and low in turn; `show` receives what to expect at each level. It ends low.

    The firmware permits this only while no station has armed it, and lowers the output within a second if this ends.
    """
    with closing(Waker()) as waker, closing(Port(settings.port, settings.baud, waker)) as port:
        exchange = Exchange(port, Link(), lambda _news, _heard_s: None, settings.port)
        ident = check_ident(exchange.identify())
        check_interlock(ident)
        try:
            for k in range(times):
                show(f"{k + 1} of {times}: line ready. A0 is at 5 V, the contact X4 is closed.")
                _hold(exchange, ident.ready_longest_ms, level_s)
                show(f"{k + 1} of {times}: line not ready. A0 is at 0 V, the contact X4 is open.")
                _hold(exchange, 0, level_s)
        finally:
            exchange.link.drop_requests()
            exchange.request(ready(PERMIT_TEST, 0))


def _hold(exchange: Exchange, hold_ms: int, level_s: float) -> None:
    """Keep the output high by renewing the test, or low if `hold_ms` is 0."""
    end_s = time.monotonic() + level_s
    while (now_s := time.monotonic()) < end_s:
        status = Status.unpack(exchange.request(ready(PERMIT_TEST, hold_ms)).payload)
        if bool(status.ready) != bool(hold_ms):
            blocked = status.hold == Hold.BARRIER or status.blocked
            raise DeviceError(
                f"The output 'line ready' stays {'low' if hold_ms else 'high'}"
                f"{': the light barrier is interrupted' if blocked else ''}.",
                action="Clear the light barrier." if blocked else "Check A0 for a short circuit.",
                code="interlock-stuck",
            )
        while time.monotonic() < min(now_s + HEARTBEAT_S, end_s):
            exchange.poll()
