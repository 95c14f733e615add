"""The controller: its port, who holds it, its firmware and its clock. Of a running station, its own word.

Only IDENT, STATUS, CLOCK and READ_EVENT are asked, which change nothing in the controller. Opening the port resets some
boards (hw/wiring.md); without a station nothing is lost by that.
"""

from __future__ import annotations

import grp
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.controller.protocol.link import Link
from vaoi_station.acquisition.controller.protocol.messages import (
    TICK_S,
    ClockReply,
    Fault,
    Ident,
    Request,
    State,
    Status,
    Type,
    number_request,
)
from vaoi_station.acquisition.controller.protocol.refusals import check_ident
from vaoi_station.acquisition.controller.serial.device_program import make_program
from vaoi_station.acquisition.controller.serial.exchange import Exchange
from vaoi_station.acquisition.controller.serial.port import Port, Waker
from vaoi_station.acquisition.controller.serial.timebase import Timebase
from vaoi_station.acquisition.process.session import CLOCK_LIMIT_S, CLOCK_SHARE
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, Level, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import Machine
from vaoi_station.errors import DeviceError, InputError

READINGS = 20
LATENCY = "sys/bus/usb-serial/devices/{name}/latency_timer"
"""Milliseconds for which an FTDI bridge keeps bytes back."""


@dataclass(frozen=True)
class ControllerReply:
    """What the controller answered."""

    ident: Ident
    status: Status
    readings: tuple[ClockReading, ...]


def controller(context: CheckContext) -> Iterator[Finding]:
    """Port, firmware, limits, state, clock."""
    if context.running is not None:
        yield of_running_station(context)
        return
    if context.config.controller.backend != "serial":
        yield not_applicable(f"backend {context.config.controller.backend!r}: there is no port")
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
        yield fault(error.message, error.action, subject="firmware")
        return
    yield judge_firmware(reply.ident)
    yield judge_limits(reply.ident, context.config)
    yield judge_status(reply.status)
    yield judge_clock(reply.readings, context.config.line.trigger_period_s)


def of_running_station(context: CheckContext) -> Finding:
    """What the station says of its controller; what is wrong with it is among the station's own complaints."""
    assert context.running is not None
    if not context.running.snapshot:
        return warning(
            "a process uses it that does not say how it is; it is left alone.",
            f"{context.running.inspect_command}; end it, and run vaoi doctor again",
        )
    return ok(str(context.running.snapshot.get("controller") or "nothing is known of it yet"))


def ask(settings: ControllerConfig) -> ControllerReply:
    """Talk to it for a moment; DeviceError says what is in the way."""
    with closing(Waker()) as waker, closing(Port(settings.port, settings.baud, waker)) as port:
        exchange = Exchange(port, Link(), lambda _news, _heard_s: None, settings.port)
        ident = check_ident(exchange.identify())
        timebase = Timebase(settings.baud)
        readings = tuple(_reading(exchange, timebase, nonce) for nonce in range(READINGS))
        return ControllerReply(ident, Status.unpack(exchange.request(Request(Type.STATUS)).payload), readings)


def _reading(exchange: Exchange, timebase: Timebase, nonce: int) -> ClockReading:
    replied = exchange.request(number_request(Type.CLOCK, nonce))
    return timebase.add_reply(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)


def judge_port(port: Path, machine: Machine) -> Finding:
    """Is it there, may it be used, does nobody else use it?"""
    try:
        found = port.stat()
    except OSError:
        there = sorted(p.name for p in (machine.root / "dev/serial/by-id").glob("*"))
        action = "Plug the controller in; deploy/71-vaoi-controller.rules in /etc/udev/rules.d/ gives it its name."
        told = f"there is no {port}; serial devices that are there: {', '.join(there) or 'none'}."
        return fault(told, action, subject="port")
    if not stat.S_ISCHR(found.st_mode) or not machine.terminal(found.st_rdev):
        return fault(f"{port} is no serial port.", "Correct `port` under [controller].", subject="port")
    if not os.access(port, os.R_OK | os.W_OK, effective_ids=True):
        group = _group(found.st_gid)
        told = f"{port} may not be read and written by this user (group {group}, {stat.filemode(found.st_mode)})."
        return fault(told, f"usermod -aG {group} vaoi, and start the service again", subject="port")
    if holders := [h for h in machine.holders(port) if h.pid != os.getpid()]:
        shown = ", ".join(f"{h.name} (process {h.pid})" for h in holders)
        return fault(f"{port} is in use by {shown}.", f"kill {holders[0].pid}, or end it another way", subject="port")
    return ok(f"{port} → {port.resolve()}, free" if port.is_symlink() else f"{port}, free", subject="port")


def judge_latency(port: Path, machine: Machine) -> Iterator[Finding]:
    """Some bridges collect bytes; that blurs the clock."""
    kept_ms = machine.number(LATENCY.format(name=port.resolve().name))
    if kept_ms is not None and kept_ms > 1:
        yield warning(
            f"the bridge keeps bytes back for {kept_ms} ms, which blurs the controller's clock.",
            f"echo 1 > /{LATENCY.format(name=port.resolve().name)}; deploy/71-vaoi-controller.rules does it for good",
            subject="port",
            figures={"latency_timer_ms": kept_ms},
        )


def judge_firmware(ident: Ident) -> Finding:
    """Which firmware; one that does not fit has been refused before."""
    version = f"{ident.firmware_major}.{ident.firmware_minor}.{ident.firmware_patch}"
    build = ident.build.rstrip(b"\0").decode("ascii", "replace")
    unit = None if ident.unit == 0xFFFFFFFF else ident.unit
    figures: Figures = {"firmware": version, "build": build, "boots": ident.boots, "unit": unit}
    named = "no number" if unit is None else f"unit {unit}"
    told = f"version {version} ({build or 'no commit'}), protocol {ident.major}.{ident.minor}, {named}"
    return ok(f"{told}, start number {ident.boots}", subject="firmware", figures=figures)


def judge_limits(ident: Ident, config: StationConfig) -> Finding:
    """Do the lights of this configuration keep the limits that are compiled in?"""
    longest = (ident.led_longest_0, ident.led_longest_1, ident.led_longest_2, ident.led_longest_3)
    figures: Figures = {f"channel_{k}_longest_us": ticks * TICK_S * 1e6 for k, ticks in enumerate(longest)}
    try:
        make_program(TriggerPlan.of(config.line), config.controller, ident)
    except InputError as error:
        action = error.action or "Correct [controller] in station.toml, or the firmware's logic/pulses/limits.h."
        return fault(error.message, action, subject="limits", figures=figures)
    shown = ", ".join(f"{ticks * TICK_S * 1e6:g}" for ticks in longest[: ident.channels])
    told = f"longest pulses {shown} µs, lit at most 1/{1 << ident.led_duty_shift} of the time"
    lights = "the lights of station.toml keep them" if config.controller.lights else "no lights are configured"
    return ok(f"{told}; {lights}", subject="limits", figures=figures)


def judge_status(status: Status) -> Finding:
    """Its state, and the barrier as it is now."""
    state = State(status.state).name.lower() if status.state in set(State) else str(status.state)
    barrier = "interrupted" if status.blocked else "free"
    figures: Figures = {"state": state, "barrier": barrier, "bad_frames": status.bad_frames}
    told = f"{state}, the light barrier is {barrier}"
    if status.state == State.SAFE:
        reason = Fault(status.fault).name.lower() if status.fault in set(Fault) else str(status.fault)
        action = "Start the station, which disarms it; look for what made it safe: docs/internals/acquisition.md."
        return warning(f"{told}; it made itself safe ({reason}).", action, subject="state", figures=figures)
    if status.state != State.IDLE:
        action = "End the program that armed it; three seconds later it makes itself safe."
        return warning(f"{told}, though no station runs here.", action, subject="state", figures=figures)
    return ok(told, subject="state", figures=figures)


def judge_clock(readings: Sequence[ClockReading], period_s: float) -> Finding:
    """How well its ticks can be told in the host's time."""
    model = ClockModel("controller")
    for reading in readings:
        model.add(reading)
    bound_s, best_s = model.bound_s(readings[-1].device_s), min(2 * reading.bound_s for reading in readings)
    figures: Figures = {"bound_ms": round(bound_s * 1e3, 4), "round_trip_ms": round(best_s * 1e3, 4)}
    told = f"known to ± {bound_s * 1e3:.2f} ms after {len(readings)} questions"
    if bound_s > (limit_s := min(CLOCK_LIMIT_S, CLOCK_SHARE * period_s)):
        told = f"{told}, but must be to ± {limit_s * 1e3:g} ms for this period."
        action = "Plug it in without a hub; install -m 644 deploy/71-vaoi-controller.rules /etc/udev/rules.d/."
        return fault(told, action, subject="clock", figures=figures)
    return ok(told, subject="clock", figures=figures)


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
