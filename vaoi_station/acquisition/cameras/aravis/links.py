"""The links of cameras: how fast a camera may send, over which links its frames go, and whether a row fits.

Names and units of speeds differ between makers: SFNC has DeviceLinkSpeed and DeviceLinkThroughputLimit in bytes per
second, GigE Vision GevLinkSpeed in Mbit/s, ViewWorks states MB/s, older cameras of Allied Vision limit
StreamBytesPerSecond.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from vaoi_station.acquisition.cameras.aravis import families, network
from vaoi_station.acquisition.cameras.aravis.discovery import USB_DEVICES
from vaoi_station.acquisition.cameras.aravis.features import Features, answered
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.optics.links import ITSELF, USB_PAYLOAD, Link, Sender, slowest_row

_MBIT_S = {"Bps": 8e-6, "MBps": 8.0, "bps": 1e-6, "Mbps": 1.0}
"""Unit of a speed → its value in Mbit/s."""
_LIMIT_MODE = "DeviceLinkThroughputLimitMode"
_NOMINAL_MBIT_S = (10, 100, 1000, 2500, 5000, 10_000, 25_000, 40_000, 100_000)
"""Speeds that links of Ethernet have."""
_ROOT_HUB = re.compile(r"usb\d+")


def speed_mbit_s(features: Features, address: str) -> float | None:
    """Return the speed of a GigE camera's own link, Mbit/s; None if the camera does not state it."""
    if stated := network.camera_link_mbit_s(address):
        return stated
    for feature, unit in families.LINK_SPEEDS:
        with answered():
            if features.has(feature):
                return _nominal(float(features.read(feature)), features.unit(feature) or unit)
    return None


def _nominal(value: float, unit: str) -> float | None:
    """Return a link's speed, Mbit/s: by the stated unit, or by another one if only then a link has that speed."""
    for factor in (_MBIT_S.get(unit, 0.0), *_MBIT_S.values()):
        if any(abs(value * factor / speed - 1) < 0.01 for speed in _NOMINAL_MBIT_S):
            return value * factor
    return None


def limit_throughput(features: Features, share_mbit_s: float | None) -> float | None:
    """Let a camera send no faster than its share of the links; return the limit that it keeps, Mbit/s, if any.

    Args:
        features: those of the camera, which is not acquiring.
        share_mbit_s: its share; None: something else keeps it to its share, and the limit is lifted.
    """
    feature = next((name for name in families.LINK_LIMITS if features.has(name)), None)
    if feature is None:
        return None
    if feature == families.LINK_LIMITS[0] and features.has(_LIMIT_MODE):
        # Some limits are always on, and say so by refusing the write.
        with answered():
            features.write(_LIMIT_MODE, "Off" if share_mbit_s is None else "On")
        if features.read(_LIMIT_MODE) == "Off":
            return None
    factor = _MBIT_S.get(features.unit(feature), _MBIT_S["Bps"])
    # A camera that keeps another limit is no fault: what it keeps counts in the time of a row.
    with answered():
        low, high, step = features.limits(feature) or (0, 0, 0)
        wanted = high if share_mbit_s is None else max(low, min(high, share_mbit_s / factor))
        features.write(feature, int(low + (wanted - low) // step * step) if step else wanted)
    return float(features.read(feature)) * factor


def pause_ticks(features: Features, delay_ns: int, tick_hz: int) -> int | None:
    """Return the value of GevSCPD for a pause after each packet; None if the camera cannot pause for so long."""
    limits = features.limits("GevSCPD") if features.has("GevSCPD") else None
    if limits is None or (delay_ns and not tick_hz):
        return None
    low, high, step = map(int, limits)
    needed, step = -(-delay_ns * tick_hz // 10**9), step or 1
    ticks = low + -(-max(0, needed - low) // step) * step
    return ticks if ticks <= high else None


def usb_path(serial: str, devices: Path = USB_DEVICES) -> tuple[Link, ...]:
    """Return the links of a USB camera, with their speeds for pixels: its own, hubs, and the host controller (xHCI)."""
    for found in devices.glob("*/serial"):
        with suppress(OSError):
            if found.read_text().strip() != serial:
                continue
            # …/pci0000:00/0000:00:14.0/usb2/2-1/2-1.3: the controller, its root hub, a hub, the camera.
            camera = found.parent.resolve()
            root = next(path for path in (camera, *camera.parents) if _ROOT_HUB.fullmatch(path.name))
            hubs = [path for path in (camera, *camera.parents) if path.is_relative_to(root)]
            names = [f"USB device {path.name}" for path in hubs[:-1]] + [f"USB controller {root.parent.name}"]
            speeds = [float((path / "speed").read_text()) * USB_PAYLOAD for path in hubs]
            return tuple(map(Link, names, speeds))
    return ()


def usb_controller(serial: str) -> str:
    """Return the name of the controller of a USB camera; "USB" if it is not known."""
    return next((link.name for link in reversed(usb_path(serial))), "USB")


def sender_of(config: CameraConfig, place: str, own_mbit_s: float | None, packet_bytes: int | None) -> Sender:
    """Return what a camera sends, over its uplink, if station.toml names one, and the port or controller.

    Args:
        config: the camera.
        place: the network interface of a GigE camera, the serial number of a USB camera.
        own_mbit_s: speed of its own link or, if it is lower, its limit.
        packet_bytes: size of its packets; None for USB.
    """
    if packet_bytes is None:
        return Sender(config.frame_bytes, usb_path(place), own_mbit_s, None)
    name, reported = f"port {place}", network.link_mbit_s(place)
    path: tuple[Link, ...] = (Link(name, config.link_mbit_s or reported),)
    if config.link is not None:
        path = (Link(config.link, config.link_mbit_s), Link(name, reported))
    return Sender(config.frame_bytes, path, own_mbit_s, packet_bytes)


def check_row(senders: Sequence[Sender], period_s: float) -> float:
    """Return the time of a row, s. Raise DeviceError if the cameras cannot send it within a trigger period."""
    slowest = slowest_row(senders)
    if slowest.row_s <= period_s:
        return slowest.row_s
    on = [sender for sender in senders if slowest.slowest in {link.name for link in sender.path}]
    speeds = [link.mbit_s for sender in on for link in sender.path if link.name == slowest.slowest and link.mbit_s]
    where = f"{len(on)} cameras on {slowest.slowest}" if on else ITSELF
    rate = min(speeds) if speeds else slowest.mbit_s or 0.0
    raise DeviceError(
        f"{where} need {slowest.row_s * 1e3:.1f} ms for a row at {rate:.0f} Mbit/s, "
        f"but a row comes every {period_s * 1e3:.1f} ms.",
        action="Give some of them a link of their own, use a faster link a shorter pixel format, or film more slowly.",
        code="link-too-slow",
    )
