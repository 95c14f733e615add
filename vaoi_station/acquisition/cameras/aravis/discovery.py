"""Find and open a camera by its address or serial number, never just the first camera that replies."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis import gvcp, network
from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error
from vaoi_station.acquisition.cameras.aravis.settings import error_text
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError, InputError

OPENING_LOCK = threading.Lock()
"""Lock to hold while devices are searched or opened, because Aravis has one list of devices per process."""


@dataclass(frozen=True)
class FoundDevice:
    """A device that replied to the search, with its address and identity."""

    serial: str
    address: str
    """IP address of a GigE camera, or Aravis' device id of a USB camera; `open_device` takes either."""


def search() -> tuple[FoundDevice, ...]:
    """Return all cameras that reply to a search now. The search takes about two seconds."""
    library = aravis()
    library.update_device_list()
    listed = range(library.get_n_devices())
    usb = [k for k in listed if library.get_device_protocol(k) == "USB3Vision"]
    # GigE cameras are searched by our own datagrams, because Aravis lists only one of two cameras with the same name.
    return (
        *(FoundDevice(present.serial, present.address) for present in gvcp.discover()),
        *(FoundDevice(library.get_device_serial_nbr(k) or "", library.get_device_id(k)) for k in usb),
    )


def find_by_serial(config: CameraConfig, found: Sequence[FoundDevice]) -> FoundDevice:
    """Return the one device that has the serial number of a configured camera.

    Args:
        config: the camera's entry in station.toml.
        found: the devices that replied to the search.

    Raises:
        DeviceError: no device has this serial number; the message lists the devices that replied.
        InputError: several devices have this serial number.
    """
    matching = [device for device in found if device.serial == config.serial]
    if not matching:
        there = ", ".join(f"{d.serial} at {d.address}" for d in found) or "none"
        raise DeviceError(
            f"{config.label}: no camera with serial number {config.serial!r} answers; cameras that answer: {there}.",
            action="Check its cable, its power and its serial number in station.toml.",
            code="camera-absent",
        )
    # A choice between them could give a camera the calibration of the other one.
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
        DeviceError: the camera is absent, or another program controls it.
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
    """Return the error for a camera that does not reply at its address. `why` is the cause, a text in brackets."""
    trouble = network.route_trouble(address)
    return DeviceError(
        f"{config.label}: there is no camera at {address} ({why}).",
        action=f"Check its cable, its power and its address in station.toml{f'; {trouble}' if trouble else ''}.",
        code="camera-absent",
    )
