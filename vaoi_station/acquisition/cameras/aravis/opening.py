"""Open all cameras of a station, set them up for the ports that they share, and check that they await the trigger."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence

from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.camera import AravisCamera
from vaoi_station.acquisition.cameras.aravis.connection import Connection, PortShare, check_silence
from vaoi_station.acquisition.cameras.aravis.discovery import OPENING_LOCK, find_by_serial, require_reply, search
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.errors import InputError

STALL_S = 1.0
"""Longest pause of this process during which the kernel's receive buffer can hold all frames of a camera."""


def open_aravis_cameras(config: StationConfig) -> tuple[AravisCamera, ...]:
    """Open every camera of a station.

    Raises:
        DeviceError: Aravis is not installed, or a camera is absent, in use, ignores a setting, or sends without a
            trigger.
        InputError: two cameras have the same serial number.
    """
    connections: list[Connection] = []
    cameras: list[AravisCamera] = []
    with OPENING_LOCK:
        try:
            for camera, where in zip(config.cameras, _locate_cameras(config.cameras), strict=True):
                # Until a light program is armed, the register holds the exposure: pulses without a program use it.
                by = camera.exposure_by if camera.exposure_by == "sequencer" else "register"
                connections.append(Connection(camera.model_copy(update={"exposure_by": by}), where))
            _check_distinct(connections)
            shares = _port_shares(config, connections)
            for connection, share in zip(connections, shares, strict=True):
                connection.configure(share)
            _check_budgets(config, connections, shares)
            for number, (connection, share) in enumerate(zip(connections, shares, strict=True)):
                cameras.append(AravisCamera(number, connection, share))
            # Checked last, with all cameras started: a camera that sends now would have its frames in wrong rows.
            check_silence(connections)
        except BaseException:  # also KeyboardInterrupt: release all cameras; it is raised on
            # An AravisCamera closes its connection; connections without an AravisCamera are closed one by one.
            for opened in cameras:
                opened.close()
            for unused in connections[len(cameras) :]:
                unused.close()
            raise
    return tuple(cameras)


def socket_bytes(camera: CameraConfig, period_s: float) -> int:
    """Return the wanted size of the kernel's receive buffer, bytes: room for all frames of `STALL_S`, at least two."""
    return max(2, math.ceil(STALL_S / period_s)) * camera.frame_bytes


def _locate_cameras(cameras: Sequence[CameraConfig]) -> list[str]:
    """Return the IP address or USB device id of each camera. One search covers all cameras given by serial number."""
    found = search() if any(camera.serial for camera in cameras) else ()
    addresses = []
    for camera in cameras:
        if camera.address is not None:
            require_reply(camera, camera.address)
            addresses.append(camera.address)
        else:
            addresses.append(find_by_serial(camera, found).address)
    return addresses


def _check_distinct(connections: Sequence[Connection]) -> None:
    """Raise InputError if two `[[cameras]]` tables of station.toml open the same device (equal serial numbers)."""
    counts = Counter(connection.identity.serial for connection in connections)
    for serial, count in counts.items():
        if count > 1:
            names = [c.config.name for c in connections if c.identity.serial == serial]
            raise InputError(
                f"cameras {', '.join(names)}: have the same serial number {serial!r}.",
                action="Check their addresses in station.toml; one camera cannot stand at two places.",
                code="camera-ambiguous",
            )


def _port_shares(config: StationConfig, connections: Sequence[Connection]) -> list[PortShare]:
    """Return for each camera the network port that it uses: number of its cameras, speed, receive buffer."""
    on_port = Counter(connection.identity.interface for connection in connections)
    shares = []
    for connection in connections:
        camera, port = connection.config, connection.identity.interface
        link_mbit_s = camera.link_mbit_s or (network.link_mbit_s(port) if port else None)
        shares.append(PortShare(on_port[port], link_mbit_s, socket_bytes(camera, config.line.shortest_period_s)))
    return shares


def _check_budgets(config: StationConfig, connections: Sequence[Connection], shares: Sequence[PortShare]) -> None:
    """Raise DeviceError if a network port is too slow to carry the frames of one row within a trigger period."""
    ports: defaultdict[str, list[int]] = defaultdict(list)
    for k, connection in enumerate(connections):
        if connection.is_gige:
            ports[connection.identity.interface].append(k)
    for port, members in ports.items():
        payloads = [connections[k].config.frame_bytes for k in members]
        packet = min(connections[k].packet_bytes for k in members)
        network.check_budget(port, payloads, packet, shares[members[0]].link_mbit_s, config.line.shortest_period_s)
