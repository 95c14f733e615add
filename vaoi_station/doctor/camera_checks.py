"""Check every camera: reachable, free, triggerable, and within the bandwidth of its network port.

Without a running station, cameras are opened and read. Written are only the control privilege, which is released
again, selectors, which are put back, and what sends test packets: the registers of the stream channel, which is closed
again. The settings that the station will write (trigger, exposure, packets) are compared with what the camera offers.
With a running station, the state is read from its REST service instead.
"""

from __future__ import annotations

import gc
import math
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis import library, links, network
from vaoi_station.acquisition.cameras.aravis.connection import (
    OPENING_LOCK,
    USB3_MIN_VERSION,
    find_packet_size,
    locate,
    open_device,
)
from vaoi_station.acquisition.cameras.aravis.features import Features
from vaoi_station.acquisition.cameras.aravis.library import glib_error
from vaoi_station.acquisition.cameras.aravis.network import TEST_STEP
from vaoi_station.acquisition.cameras.aravis.sequencer import missing_features
from vaoi_station.acquisition.cameras.aravis.settings import (
    TRIGGER_WIDTH,
    Control,
    deviations,
    frame_trigger,
    has_ptp,
    limits_of,
    trigger_line,
)
from vaoi_station.config import CameraConfig
from vaoi_station.doctor.finding import Figures, Finding, Level, fault, not_applicable, ok, warning
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.errors import DeviceError, VaoiError


def aravis(context: CheckContext) -> Iterator[Finding]:
    """Check that PyGObject and Aravis can be imported, and their versions."""
    if not context.real_cameras:
        yield not_applicable("no camera uses Aravis")
        return
    try:
        library.aravis()
        found = library.version()
    except DeviceError as error:
        yield fault(error.code, error.message, error.action)
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
            "aravis-old",
            f"{message}: unreliable with USB3 cameras; {perhaps_usb} of the cameras may be on USB.",
            "Name GigE cameras by their address; for USB3 use a distribution with Aravis 0.8.30 or later (Debian 13).",
            **figures,
        )
    return ok(message, **figures)


GIGABIT_MBIT_S = 1000.0
JUMBO = 8000
"""Packet size in bytes below which a port is reported. MTU 1500 needs six times as many packets as MTU 9000."""


@dataclass(frozen=True)
class Offered:
    """The identity and the capabilities of a camera, as read from the camera."""

    vendor: str
    model: str
    serial: str
    triggers: tuple[str, ...]
    sources: tuple[str, ...]
    formats: tuple[str, ...]
    exposure_us: tuple[float, float] | None
    sensor: tuple[int | None, int | None]
    """Its columns and lines; None: the description does not state them."""
    trigger_mode: str
    """Present trigger mode of the camera. The station sets the mode when it starts."""
    port: str = ""
    """Network interface of this computer that leads to the camera, or its USB controller."""
    address: str = ""
    packets: network.PacketLimits | None = None
    passing: int | None = None
    """Largest packet that came from the camera in one piece; None if it sends no test packets."""
    speed_mbit_s: float | None = None
    """Speed of its own link."""
    exposure_modes: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    """What another program has left in the camera and the station changes: feature, value, new value and why."""
    black_level: float | None = None
    has_ptp: bool = False


def cameras(context: CheckContext) -> Iterator[Finding]:
    """Report at least one finding per camera, and one per network port."""
    if context.running is not None:
        yield from of_running_station(context)
    elif not context.real_cameras:
        yield not_applicable(f"backend {context.config.controller.backend!r}: there are no real cameras")
    else:
        yield from of_real_cameras(context)


def of_real_cameras(context: CheckContext) -> Iterator[Finding]:
    """Open and judge the cameras one after the other, then judge the network ports of the cameras that replied."""
    ports: defaultdict[str, list[tuple[CameraConfig, Offered]]] = defaultdict(list)
    serials: defaultdict[str, list[str]] = defaultdict(list)
    for camera in context.real_cameras:
        try:
            offered = ask(camera)
        except VaoiError as error:
            message = error.message.removeprefix(f"{camera.label}: ")
            action = f"{error.action} {_search_hint(camera, error)}".strip()
            yield fault(error.code, message, action, camera.name)
            continue
        except glib_error() as error:
            message, action = (
                f"stopped replying during the check: {error}",
                "Check its cable and power; switch it off and on.",
            )
            yield fault("camera-stopped-replying", message, action, camera.name)
            continue
        yield from judge_camera(camera, offered)
        serials[offered.serial].append(camera.name)
        if offered.port:
            ports[offered.port].append((camera, offered))
    for serial, names in serials.items():
        if len(names) > 1:
            message, action = (
                f"{', '.join(names)} have the same serial number {serial!r}.",
                "Correct their addresses in station.toml.",
            )
            yield fault("camera-ambiguous", message, action, names[0], serial=serial)
    for port, members in ports.items():
        yield judge_port(port, members, context.config.line.shortest_period_s)


def _search_hint(camera: CameraConfig, error: VaoiError) -> str:
    if error.code != "camera-absent":
        return ""
    return f"Try: ping -c 1 {camera.address}" if camera.address else "Try: arv-tool-0.8"


def ask(camera: CameraConfig) -> Offered:
    """Open a camera, read its capabilities, and close it; DeviceError or InputError if it refuses."""
    with OPENING_LOCK, _opened(camera) as opened:
        device = opened.get_device()
        port = address = ""
        packets = passing = speed_mbit_s = None
        if not opened.is_gv_device():
            port = links.usb_controller(library.text_of(opened.get_device_serial_number))
        else:
            address = device.get_device_address().get_address().to_string()
            local = device.get_interface_address().get_address().to_string()
            port = network.interface_of(local)
            packets = network.PacketLimits.stated(Features(opened).limits("GevSCPSPacketSize"))
            passing = find_packet_size(opened, camera, packets, address, local)[1]
            speed_mbit_s = links.speed_mbit_s(Features(opened), address)
        control = Control(opened, camera.label)
        features = control.features
        black_level = features.read("BlackLevel") if features.has("BlackLevel") else None
        return Offered(
            vendor=library.text_of(opened.get_vendor_name),
            model=library.text_of(opened.get_model_name),
            serial=library.text_of(opened.get_device_serial_number),
            triggers=features.entries("TriggerSelector"),
            sources=features.entries("TriggerSource"),
            formats=features.entries("PixelFormat"),
            exposure_us=limits_of(opened).exposure_us,
            exposure_modes=features.entries("ExposureMode"),
            without=missing_features(features),
            left=tuple(_left_over(control, camera)),
            has_ptp=has_ptp(features),
            black_level=None if black_level is None else float(black_level),
            # WidthMax and HeightMax shrink with binning, so they state no sensor.
            sensor=(_stated(features, "SensorWidth"), _stated(features, "SensorHeight")),
            trigger_mode=str(features.read("TriggerMode")) if features.has("TriggerMode") else "Off",
            port=port,
            address=address,
            packets=packets,
            passing=passing,
            speed_mbit_s=speed_mbit_s,
        )


def _stated(features: Features, name: str) -> int | None:
    """Return the value of a feature; None if the camera does not have it."""
    return int(features.read(name)) if features.has(name) else None


def _left_over(control: Control, camera: CameraConfig) -> Iterator[str]:
    with suppress(DeviceError):  # without a trigger, nothing else matters
        for setting, got in deviations(control, camera):
            yield f"{setting.name} from {got} to {setting.value} (else {setting.why})"


@contextmanager
def _opened(camera: CameraConfig) -> Iterator[Any]:
    opened = open_device(camera, locate(camera))
    try:
        yield opened
    finally:
        del opened
        # Aravis releases the control privilege with the last reference; without the collection a cycle could keep it.
        gc.collect()


def judge_camera(camera: CameraConfig, offered: Offered) -> Iterator[Finding]:
    """Compare a camera's capabilities with what station.toml requires."""
    wrong = list(_shortcomings(camera, offered))
    yield from wrong
    if not wrong:
        named = f"{offered.vendor} {offered.model} {offered.serial}".strip()
        mode = "on" if offered.trigger_mode == "On" else f"{offered.trigger_mode.lower()} now, the station turns it on"
        figures: Figures = {
            "serial": offered.serial,
            "trigger_mode": offered.trigger_mode,
            "port": offered.port,
            "black_level": offered.black_level,
        }
        yield ok(f"{named} replies and is free; the trigger is {mode}", camera.name, **figures)
    # No fault, as every opening sets these: it explains why another program's pictures look different.
    if offered.left:
        message = f"the station will change what another program left in it: {'; '.join(offered.left)}"
        yield ok(message, camera.name, left_over=len(offered.left))
    yield from _slow_link(camera, offered)


def _slow_link(camera: CameraConfig, offered: Offered) -> Iterator[Finding]:
    speed = offered.speed_mbit_s
    if speed is not None and speed < GIGABIT_MBIT_S:
        message = (
            f"has a link of {speed:g} Mbit/s only: with a pair of wires broken, Gigabit Ethernet falls back to that."
        )
        action = "Exchange its cable, and check plugs and switch."
        yield warning("camera-link-slow", message, action, camera.name, link_mbit_s=speed)


def _shortcomings(camera: CameraConfig, offered: Offered) -> Iterator[Finding]:
    name = camera.name
    line = trigger_line(camera, offered.vendor, offered.sources)
    one_of_these = "in station.toml to one of these."
    if offered.triggers and frame_trigger(offered.triggers) is None:
        shown = ", ".join(offered.triggers) or "nothing"
        message = f"offers the triggers {shown} only, but a frame trigger by wire is needed."
        yield fault("camera-without-trigger", message, "Use a camera with a trigger input.", name)
    elif line not in offered.sources:
        message = f"has no trigger input {line}; it has {', '.join(offered.sources)}."
        yield fault("camera-without-input", message, f'Set trigger_line = "…" {one_of_these}', name)
    if camera.pixel_format not in offered.formats:
        message = f"has no pixel format {camera.pixel_format}; it has {', '.join(offered.formats)}."
        yield fault("camera-without-format", message, f"Set pixel_format {one_of_these}", name)
    if offered.exposure_us and not offered.exposure_us[0] <= camera.exposure_us <= offered.exposure_us[1]:
        low, high = offered.exposure_us
        message = f"cannot expose for {camera.exposure_us:g} µs; its range is {low:g} … {high:g} µs."
        yield fault("exposure-out-of-range", message, "Set exposure_us in station.toml within this range.", name)
    by_register = 'Set exposure_by = "auto" or "register" in station.toml.'
    if camera.exposure_by == "trigger-width" and TRIGGER_WIDTH not in offered.exposure_modes:
        has = f"its exposure modes are {', '.join(offered.exposure_modes)}" if offered.exposure_modes else "it has none"
        message = f"cannot expose for the width of the trigger, as exposure_by states: {has}."
        yield fault("camera-without-trigger-width", message, by_register, name)
    if camera.exposure_by == "sequencer" and offered.without:
        message = f"has no sequencer, as exposure_by states: {', '.join(offered.without)} missing."
        yield fault("sequencer-absent", message, by_register, name)
    if camera.ptp and not offered.has_ptp:
        message = "has no PTP, as ptp = true states."
        yield fault("feature-absent", message, "Remove ptp of this camera from station.toml.", name)
    right, bottom = camera.offset_px[0] + camera.width, camera.offset_px[1] + camera.height
    width, height = (size or math.inf for size in offered.sensor)
    if right > width or bottom > height:
        message = f"has a sensor of {width}×{height} px, but the configured frame ends at column {right}, row {bottom}."
        yield fault("frame-exceeds-sensor", message, "Correct width, height and offset_px in station.toml.", name)


def judge_port(port: str, members: list[tuple[CameraConfig, Offered]], period_s: float) -> Finding:
    """Judge packets and bandwidth of one network port or USB controller, for all cameras connected to it."""
    if all(offered.packets is None for _, offered in members):
        return _judge_row(port, members, [None] * len(members), period_s, "by USB")
    mtu = min(network.mtu_to(offered.address) for _, offered in members)
    try:
        most = [network.packet_bytes(c.packet_bytes, mtu, o.packets) for c, o in members if o.packets]
    except VaoiError as error:
        return fault(error.code, error.message, error.action, port, mtu=mtu)
    sizes = [o.passing or size for (_, o), size in zip(members, most, strict=True)]
    packet, unproven = min(sizes), [c.name for c, o in members if o.passing is None]
    shown = f"MTU {mtu}, packets of {packet} bytes"
    if unproven:
        shown += f" (by the MTU alone: no test packets from {', '.join(unproven)})"
    found = _judge_row(port, members, sizes, period_s, shown, mtu=mtu, packet_bytes=packet)
    return _judge_packets(found, members, mtu, packet, min(most)) if found.level is Level.OK else found


def _judge_packets(
    found: Finding, members: list[tuple[CameraConfig, Offered]], mtu: int, packet: int, possible: int
) -> Finding:
    """Judge the size of packets that can carry a row. `possible` is the size that cameras and port permit."""
    port = found.subject
    if wished := [c for c, _ in members if c.packet_bytes and c.packet_bytes > packet]:
        wish = wished[0].packet_bytes or 0
        # A larger MTU helps only up to the size that the camera itself can send.
        allowed = f"Set packet_bytes to {packet}: the cameras of this port send no larger packets."
        action = f"ip link set dev {port} mtu {wish}" if wish > mtu else allowed
        message = f"{found.message}; {wished[0].name} is configured for {wish}."
        return warning("packets-above-mtu", message, action, port, **found.figures)
    if packet < possible - TEST_STEP:
        message = f"{found.message}; larger ones are dropped on the way."
        action = "Switch jumbo frames on in the switches between cameras and computer."
        return warning("packets-above-path", message, action, port, **found.figures)
    if packet < JUMBO:
        message = f"{found.message}; larger packets cost less processor time."
        return warning("packets-small", message, f"ip link set dev {port} mtu 9000", port, **found.figures)
    return found


def _judge_row(
    port: str,
    members: list[tuple[CameraConfig, Offered]],
    sizes: Sequence[int | None],
    period_s: float,
    shown: str,
    **known: int,
) -> Finding:
    senders = [
        links.sender_of(camera, port if size else offered.serial, offered.speed_mbit_s, size)
        for (camera, offered), size in zip(members, sizes, strict=True)
    ]
    try:
        row_s = links.check_row(senders, period_s)
    except VaoiError as error:
        return fault(error.code, error.message, error.action, port, **known)
    speed = senders[0].path[-1].mbit_s if senders[0].path else None
    figures: Figures = {**known, "link_mbit_s": speed, "cameras": len(members), "row_ms": round(row_s * 1e3, 3)}
    message = f"{len(members)} camera{'s' if len(members) > 1 else ''}, {shown}"
    rate = f"{speed:g} Mbit/s, a row takes {row_s * 1e3:.1f} ms" if speed else "link speed unknown"
    return ok(f"{message}, {rate}", port, **figures)


def of_running_station(context: CheckContext) -> Iterator[Finding]:
    """Report the state of all cameras as the running station's REST service gives it."""
    assert context.running is not None
    states = context.running.snapshot.get("cameras", ())
    if not states:
        yield warning(
            "cameras-unreported",
            "another process uses the cameras and does not report their state; they were not opened.",
            f"{context.running.inspect_command}; end it, and run vaoi doctor again",
        )
    yield from (_judge_reported(state) for state in states)


def _judge_reported(state: dict[str, Any]) -> Finding:
    name, message = str(state.get("name")), str(state.get("message") or "")
    for called in (name, f"camera {name}"):
        message = message.removeprefix(f"{called}: ")
    figures: Figures = {key: state.get(key) for key in ("delivered", "incomplete", "temperature_c")}
    if not state.get("connected"):
        action = "Check its power and cable; the station opens it again by itself."
        message = f"is not connected: {message or 'no reason given'}"
        return fault("camera-lost", message, action, name, **figures)
    if message:
        action = "Do what the message asks; check cable, plugs and switch of this camera, then let a board pass."
        return warning("camera-remark", message, action, name, **figures)
    counted = f"{figures['delivered']} frames delivered, {figures['incomplete']} incomplete"
    if ptp := state.get("ptp"):  # its troubles are warnings of the station
        counted += f", PTP state {ptp['state'] or 'not stated'}"
    return ok(f"connected, {counted}", name, **figures)
