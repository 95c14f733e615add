"""Which device is meant: by its address, or by its serial number among all that answer; never the first one found."""

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
"""Devices are looked for and opened one at a time: Aravis' list of devices is one for the process."""


@dataclass(frozen=True)
class FoundDevice:
    """A device that answered."""

    serial: str
    address: str
    """IP address of a GigE camera, Aravis' device id of a USB camera: what opens it."""


def search() -> tuple[FoundDevice, ...]:
    """All devices that answer now; takes about two seconds."""
    library = aravis()
    library.update_device_list()
    listed = range(library.get_n_devices())
    usb = [k for k in listed if library.get_device_protocol(k) == "USB3Vision"]
    return (
        *(FoundDevice(present.serial, present.address) for present in gvcp.discover()),
        *(FoundDevice(library.get_device_serial_nbr(k) or "", library.get_device_id(k)) for k in usb),
    )


def find_by_serial(config: CameraConfig, found: Sequence[FoundDevice]) -> FoundDevice:
    """The device with the camera's serial number.

    Raises:
        DeviceError: none has it; the message tells those that answer.
        InputError: several have it.
    """
    matching = [device for device in found if device.serial == config.serial]
    if not matching:
        there = ", ".join(f"{d.serial} at {d.address}" for d in found) or "none"
        raise DeviceError(
            f"{config.label}: no camera with serial number {config.serial!r} answers; those that do: {there}.",
            action="Check its cable, its power and its serial number in station.toml.",
            code="camera-absent",
        )
    if len(matching) > 1:
        places = ", ".join(d.address for d in matching)
        raise InputError(
            f"{config.label}: {len(matching)} cameras have the serial number {config.serial!r} ({places}).",
            action="Give their addresses in station.toml instead of the serial number.",
            code="camera-ambiguous",
        )
    return matching[0]


def open_device(config: CameraConfig, address: str) -> Any:
    """The `Aravis.Camera` at an address (or, of USB, with a device id), controlled by us.

    Raises:
        DeviceError: it is absent, or somebody else controls it.
    """
    try:
        camera = aravis().Camera.new(address)
    except glib_error() as error:
        raise absence_error(config, address, error_text(error)) from error
    if camera.is_gv_device() and not camera.get_device().is_controller():
        raise DeviceError(
            f"{config.label}: another program controls the camera at {address}.",
            action="Close that program (a viewer of the maker, another station); the camera is then opened by itself.",
            code="camera-in-use",
        )
    return camera


def require_reply(config: CameraConfig, address: str) -> None:
    """DeviceError if nobody answers at an IP address: much sooner than Aravis would find out."""
    if not gvcp.is_reachable(address):
        raise absence_error(config, address, "it does not answer")


def absence_error(config: CameraConfig, address: str, why: str) -> DeviceError:
    """There is no camera, or no longer."""
    return DeviceError(
        f"{config.label}: there is no camera at {address} ({why}).",
        action="Check its cable, its power and its address in station.toml.",
        code="camera-absent",
    )
