"""Every camera: is it there and free, can it be triggered, does its port carry it? Of a running station, its own word.

Cameras are opened and read, and nothing is written to them but the privilege to be their only master, which is given
back. What the station will set (trigger, exposure, packets) is compared with what the camera offers.
"""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.discovery import (
    OPENING_LOCK,
    find_by_serial,
    open_device,
    require_reply,
    search,
)
from vaoi_station.acquisition.cameras.aravis.library import glib_error
from vaoi_station.acquisition.cameras.aravis.trigger import FRAME_TRIGGERS, recipe_for
from vaoi_station.config import CameraConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.errors import VaoiError

JUMBO = 8000
"""Ports of smaller packets than this make four times as many of them."""


@dataclass(frozen=True)
class Offered:
    """What a camera says it is and can; nothing of it was set by us."""

    vendor: str
    model: str
    serial: str
    triggers: tuple[str, ...]
    sources: tuple[str, ...]
    """Inputs a trigger can come from."""
    formats: tuple[str, ...]
    exposure_us: tuple[float, float]
    sensor: tuple[int, int]
    trigger_mode: str
    """As it happens to be; the station sets it."""
    port: str = ""
    """Of this computer; empty on USB."""
    address: str = ""
    packets: network.PacketLimits | None = None


def cameras(context: CheckContext) -> Iterator[Finding]:
    """One finding per camera, more where something is wrong, and one per network port."""
    if context.running is not None:
        yield from of_running_station(context)
    elif not context.real_cameras:
        yield not_applicable(f"backend {context.config.controller.backend!r}: there is nothing to reach")
    else:
        yield from of_real_cameras(context)


def of_real_cameras(context: CheckContext) -> Iterator[Finding]:
    """Asked one after the other; ports are looked at with the cameras that answered."""
    ports: defaultdict[str, list[tuple[CameraConfig, Offered]]] = defaultdict(list)
    serials: defaultdict[str, list[str]] = defaultdict(list)
    for camera in context.real_cameras:
        try:
            offered = ask(camera)
        except VaoiError as error:
            told = error.message.removeprefix(f"{camera.label}: ")
            yield fault(told, f"{error.action} {_look_for(camera, error)}".strip(), subject=camera.name)
            continue
        except glib_error() as error:
            action = "Check its cable and power; switch it off and on."
            yield fault(f"stopped answering while it was asked: {error}", action, subject=camera.name)
            continue
        yield from judge_camera(camera, offered)
        serials[offered.serial].append(camera.name)
        if offered.port:
            ports[offered.port].append((camera, offered))
    for serial, names in serials.items():
        if len(names) > 1:
            told = f"{', '.join(names)} have the same serial number {serial!r}."
            yield fault(told, "Correct their addresses in station.toml.", subject=names[0])
    for port, members in ports.items():
        yield judge_port(port, members, context.config.line.trigger_period_s)


def _look_for(camera: CameraConfig, error: VaoiError) -> str:
    """A command that shows more of a camera that is absent."""
    if error.code != "camera-absent":
        return ""
    return f"Try: ping -c 1 {camera.address}" if camera.address else "Try: arv-tool-0.8"


def ask(camera: CameraConfig) -> Offered:
    """Open it, look, close it; DeviceError or InputError if that cannot be done."""
    with OPENING_LOCK, _opened(camera) as opened:
        device = opened.get_device()
        port = address = ""
        packets = None
        if opened.is_gv_device():
            address = device.get_device_address().get_address().to_string()
            port = network.interface_of(device.get_interface_address().get_address().to_string())
            smallest, largest = opened.get_integer_bounds("GevSCPSPacketSize")
            step = max(1, opened.get_integer_increment("GevSCPSPacketSize"))
            packets = network.PacketLimits(smallest, largest, step)
        low, high = opened.get_exposure_time_bounds()
        width, height = opened.get_sensor_size()
        return Offered(
            vendor=opened.get_vendor_name() or "",
            model=opened.get_model_name() or "",
            serial=opened.get_device_serial_number() or "",
            triggers=tuple(opened.dup_available_triggers()),
            sources=tuple(opened.dup_available_enumerations_as_strings("TriggerSource")),
            formats=tuple(opened.dup_available_pixel_formats_as_strings()),
            exposure_us=(low, high),
            sensor=(width, height),
            trigger_mode=device.get_string_feature_value("TriggerMode"),
            port=port,
            address=address,
            packets=packets,
        )


@contextmanager
def _opened(camera: CameraConfig) -> Iterator[Any]:
    if camera.address is not None:
        require_reply(camera, camera.address)
        where = camera.address
    else:
        where = find_by_serial(camera, search()).address
    opened = open_device(camera, where)
    try:
        yield opened
    finally:
        del opened
        gc.collect()  # Aravis gives the camera back with the last reference


def judge_camera(camera: CameraConfig, offered: Offered) -> Iterator[Finding]:
    """Can it do what station.toml asks of it?"""
    wrong = list(_shortcomings(camera, offered))
    yield from (fault(told, action, subject=camera.name) for told, action in wrong)
    if not wrong:
        named = f"{offered.vendor} {offered.model} {offered.serial}".strip()
        mode = "on" if offered.trigger_mode == "On" else f"{offered.trigger_mode.lower()} now, the station turns it on"
        figures: Figures = {"serial": offered.serial, "trigger_mode": offered.trigger_mode, "port": offered.port}
        yield ok(f"{named} answers and is free; trigger is {mode}", subject=camera.name, figures=figures)


def _shortcomings(camera: CameraConfig, offered: Offered) -> Iterator[tuple[str, str]]:
    """What is wrong, and what to do."""
    line = camera.trigger_line or recipe_for(offered.vendor).line
    if not set(FRAME_TRIGGERS) & set(offered.triggers):
        shown = ", ".join(offered.triggers) or "nothing"
        yield f"can be triggered by {shown} only, not by a wire.", "Use a camera with a trigger input."
    elif line not in offered.sources:
        shown = ", ".join(offered.sources)
        yield f"has no trigger input {line}, but {shown}.", 'Set trigger_line = "…" to one of these in station.toml.'
    if camera.pixel_format not in offered.formats:
        yield (
            f"has no pixel format {camera.pixel_format}, but {', '.join(offered.formats)}.",
            "Set pixel_format to one of these.",
        )
    low, high = offered.exposure_us
    if not low <= camera.exposure_us <= high:
        yield f"cannot expose {camera.exposure_us:g} µs, only {low:g} … {high:g}.", "Set exposure_us within these."
    needed = (camera.offset_px[0] + camera.width, camera.offset_px[1] + camera.height)
    if needed[0] > offered.sensor[0] or needed[1] > offered.sensor[1]:
        has = "{}×{} px".format(*offered.sensor)
        yield f"has {has}, the frame ends at {needed[0]}, {needed[1]}.", "Correct width, height and offset_px."


def judge_port(port: str, members: list[tuple[CameraConfig, Offered]], period_s: float) -> Finding:
    """Packets and bandwidth of one network port."""
    mtu = min(network.mtu_to(offered.address) for _, offered in members)
    try:
        packet = min(network.packet_bytes(c.packet_bytes, mtu, o.packets) for c, o in members if o.packets)
        link = members[0][0].link_mbit_s or network.link_mbit_s(port)
        network.check_budget(port, [c.frame_bytes for c, _ in members], packet, link, period_s)
    except VaoiError as error:
        return fault(error.message, error.action, subject=port, figures={"mtu": mtu})
    figures: Figures = {"mtu": mtu, "packet_bytes": packet, "link_mbit_s": link, "cameras": len(members)}
    speed = f"{link:g} Mbit/s" if link else "a link without a speed"
    told = f"{len(members)} camera{'s' if len(members) > 1 else ''}, MTU {mtu}, packets of {packet} bytes, {speed}"
    if wished := [c for c, _ in members if c.packet_bytes and c.packet_bytes > packet]:
        wish = wished[0].packet_bytes or 0
        allowed = f"Set packet_bytes to {packet}: a camera of this port sends no larger ones."
        action = f"ip link set dev {port} mtu {wish}" if wish > mtu else allowed
        return warning(f"{told}; {wished[0].name} is to have {wish}.", action, subject=port, figures=figures)
    if packet < JUMBO:
        return warning(
            f"{told}; larger ones cost less time.", f"ip link set dev {port} mtu 9000", subject=port, figures=figures
        )
    return ok(told, subject=port, figures=figures)


def of_running_station(context: CheckContext) -> Iterator[Finding]:
    """What the station says of its cameras."""
    assert context.running is not None
    told = context.running.snapshot.get("cameras", ())
    if not told:
        yield warning(
            "a process uses them that does not say how they are; they are left alone.",
            f"{context.running.inspect_command}; end it, and run vaoi doctor again",
        )
    yield from (_of_camera(camera) for camera in told)


def _of_camera(told: dict[str, Any]) -> Finding:
    name, message = str(told.get("name")), str(told.get("message") or "")
    for called in (name, f"camera {name}"):
        message = message.removeprefix(f"{called}: ")
    figures: Figures = {key: told.get(key) for key in ("delivered", "incomplete", "temperature_c")}
    if not told.get("connected"):
        action = "Check its power and cable; the station opens it by itself when it is back."
        return fault(f"is not connected: {message or 'no reason given'}", action, subject=name, figures=figures)
    if message:
        return warning(message, "See docs/internals/acquisition.md.", subject=name, figures=figures)
    counted = f"{figures['delivered']} frames delivered, {figures['incomplete']} incomplete"
    return ok(f"connected, {counted}", subject=name, figures=figures)
