"""Finds and opens devices by address or serial number, never simply the first one found."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis import gvcp
from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error
from vaoi_station.acquisition.cameras.aravis.settings import error_text
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError, InputError

OPENING_LOCK = threading.Lock()
"""Held while devices are searched or opened: Aravis has one list of devices per process."""


@dataclass(frozen=True)
class FoundDevice:
    """A device that replied to the search."""

    serial: str
    address: str
    """What opens it: the IP address of a GigE camera, or Aravis' device id of a USB camera."""


def search() -> tuple[FoundDevice, ...]:
    """Search all devices that reply now; takes about two seconds."""
    library = aravis()
    library.update_device_list()
    listed = range(library.get_n_devices())
    usb = [k for k in listed if library.get_device_protocol(k) == "USB3Vision"]
    # GigE cameras are searched by our own datagrams: of two with the same name Aravis lists only one.
    return (
        *(FoundDevice(present.serial, present.address) for present in gvcp.discover()),
        *(FoundDevice(library.get_device_serial_nbr(k) or "", library.get_device_id(k)) for k in usb),
    )


def find_by_serial(config: CameraConfig, found: Sequence[FoundDevice]) -> FoundDevice:
    """Return the device with the camera's serial number.

    Raises:
        DeviceError: no device has it; the message lists those that replied.
        InputError: several devices have it.
    """
    matching = [device for device in found if device.serial == config.serial]
    if not matching:
        there = ", ".join(f"{d.serial} at {d.address}" for d in found) or "none"
        raise DeviceError(
            f"{config.label}: no camera with serial number {config.serial!r} answers; those that do: {there}.",
            action="Check its cable, its power and its serial number in station.toml.",
            code="camera-absent",
        )
    # Taking either would mix up the calibrations of two cameras.
    if len(matching) > 1:
        places = ", ".join(d.address for d in matching)
        raise InputError(
            f"{config.label}: {len(matching)} cameras have the serial number {config.serial!r} ({places}).",
            action="Give their addresses in station.toml instead of the serial number.",
            code="camera-ambiguous",
        )
    return matching[0]


def open_device(config: CameraConfig, address: str) -> Any:
    """Open the `Aravis.Camera` at an address (USB: a device id) and take control of it.

    Raises:
        DeviceError: it is absent, or another program controls it.
    """
    try:
        camera = aravis().Camera.new(address)
    except glib_error() as error:
        raise absence_error(config, address, error_text(error)) from error
    # `Camera.new` succeeds for a camera of another client; only `create_stream` would fail, with code 10 (measured).
    if camera.is_gv_device() and not camera.get_device().is_controller():
        raise DeviceError(
            f"{config.label}: another program controls the camera at {address}.",
            action="Close that program (the maker's viewer, another station); the camera is then opened automatically.",
            code="camera-in-use",
        )
    return camera


def require_reply(config: CameraConfig, address: str) -> None:
    """Raise DeviceError if no camera replies at an IP address."""
    # Aravis needs 1.0 to 2.5 s to fail for an absent address (measured).
    if not gvcp.is_reachable(address):
        raise absence_error(config, address, "it does not answer")


def absence_error(config: CameraConfig, address: str, why: str) -> DeviceError:
    """Make the error of a camera that is not there."""
    return DeviceError(
        f"{config.label}: there is no camera at {address} ({why}).",
        action="Check its cable, its power and its address in station.toml.",
        code="camera-absent",
    )
