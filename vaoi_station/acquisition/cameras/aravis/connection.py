"""One connection to one camera, from opening to loss; none of its objects is used again afterwards.

In Aravis only pushing and popping of buffers is thread-safe. So all access to the camera goes through one lock; the
stream uses one thread only and needs none.
"""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis import network, settings
from vaoi_station.acquisition.cameras.aravis.clock import find_clock
from vaoi_station.acquisition.cameras.aravis.discovery import open_device
from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error, version
from vaoi_station.acquisition.cameras.aravis.settings import Setting
from vaoi_station.acquisition.cameras.aravis.stream import FrameFormat, SlotResult, SlotStream
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.pixel_formats import PIXEL_FORMATS

USB3_MIN_VERSION = (0, 8, 30)
"""The first version of Aravis that is reliable with USB3."""
# Before 0.8.28 it waits in a busy loop (Aravis #652); 0.8.29 corrected underruns (#568), and 0.8.30 sets a buffer's
# status before it is passed on.
RETENTION_US = 200_000
"""How long Aravis waits for the rest of a frame."""
# Its default of 100 ms lost the first frames after a pause (Aravis #818, #746).


@dataclass(frozen=True)
class Identity:
    """The identity of a camera and of the port it replied on."""

    vendor: str
    model: str
    serial: str
    address: str
    """IP address, or device id of a USB camera."""
    interface: str
    """Network interface of this computer; empty for USB."""


@dataclass(frozen=True)
class PortShare:
    """A camera's share of a network port."""

    cameras: int = 1
    """Number of cameras on the port, including this one."""
    link_mbit_s: float | None = None
    socket_bytes: int = 0
    """Wanted size of the kernel's buffer for its packets."""


class Connection:
    """An open camera; call `configure`, then `start`, then `close`."""

    def __init__(self, config: CameraConfig, where: str) -> None:
        """Open the camera at an address.

        Raises:
            DeviceError: it is absent, or another program controls it.
        """
        self.config = config
        self._camera: Any = open_device(config, where)
        self._lock = threading.Lock()
        self._stream: SlotStream | None = None
        self.is_gige = bool(self._camera.is_gv_device())
        self.packet_bytes = 0
        self.granted_bytes = 0
        """Size of the kernel's buffer for its packets, as granted."""
        with self._device_access("does not report its identity"):
            self.identity = self._identity(where)
            self._clock = find_clock(self._camera, config.label)
            self._thermometer = self._camera.get_device().is_feature_available("DeviceTemperature")

    def configure(self, share: PortShare) -> None:
        """Write all settings and read them back; for GigE also those of the packets.

        Raises:
            DeviceError: a setting is refused or ignored, or the frame size is not that of the slots.
        """
        with self._device_access("does not take its settings"):
            # An earlier program may have left the acquisition running, and settings are locked meanwhile. A camera that
            # is not running may refuse the command.
            with contextlib.suppress(glib_error()):
                self._camera.stop_acquisition()
            settings.apply(self._camera, self.config)
            if self.is_gige:
                self._configure_packets(share)
            payload = self._camera.get_payload()
        if payload != self.config.frame_bytes:
            raise DeviceError(
                f"{self.config.label}: sends frames of {payload} bytes, but {self.config.width}×"
                f"{self.config.height} px {self.config.pixel_format} are {self.config.frame_bytes}.",
                action="Turn chunk data and line padding off ([cameras.features]), or correct width, height, format.",
                code="frame-size",
            )

    def start(self, on_slot: Callable[[SlotResult], None], share: PortShare) -> None:
        """Create the stream and start the acquisition; `on_slot` is called with every used slot.

        Raises:
            DeviceError: the stream cannot be created.
        """
        with self._device_access("cannot be started"):
            # No callback: it would run Python in Aravis' threads, which crashed (Aravis #453, #714, #941), and stall
            # reception while the GIL is busy.
            stream = self._camera.create_stream(None, None)
            if self.is_gige:
                stream.set_property("frame-retention", RETENTION_US)
                # Set here and checked, not by Aravis' property `socket-buffer`: the kernel may grant less without an
                # error (Aravis #894, #898), and the automatic mode with a small limit logs every frame (#994).
                self.granted_bytes = network.widen_receive_buffer(stream.get_port(), share.socket_bytes)
            kind = FrameFormat(self.config.width, self.config.height, PIXEL_FORMATS[self.config.pixel_format].code)
            self._stream = SlotStream(stream, kind, on_slot, f"camera-{self.config.name}")
            self._camera.start_acquisition()

    @property
    def stream(self) -> SlotStream:
        """The stream to which slots are queued, once started."""
        assert self._stream is not None
        return self._stream

    def counters(self) -> dict[str, int]:
        """Return the stream's counters by name; none once closed."""
        stream = self._stream
        return {} if stream is None else stream.counters()

    def traffic(self) -> int:
        """Return a number that grows with anything the camera sends."""
        return sum(self.counters().values())

    def read_clock(self, epoch_ns: int) -> ClockReading:
        """Compare the camera's clock with the host's; DeviceError if the camera does not reply."""
        if not self._clock.remote:
            return self._clock.read(epoch_ns)
        with self._device_access("does not report its time"):
            return self._clock.read(epoch_ns)

    def temperature_c(self) -> float | None:
        """Read the temperature; None if the camera has no thermometer."""
        if not self._thermometer:
            return None
        with self._device_access("does not report its temperature"):
            return float(self._camera.get_device().get_float_feature_value("DeviceTemperature"))

    def is_controller(self) -> bool:
        """Return whether this process still controls the camera, by Aravis' latest knowledge."""
        return not self.is_gige or bool(self._camera.get_device().is_controller())

    def warning(self, share: PortShare) -> str:
        """Return a warning of a condition that may lose frames under load; empty if there is none."""
        if not self.is_gige:
            found = version()
            return "" if found >= USB3_MIN_VERSION else f"Aravis {'.'.join(map(str, found))} is unreliable with USB3."
        if self.granted_bytes >= share.socket_bytes:
            return ""
        return (
            f"The kernel holds {self.granted_bytes / 1e6:.1f} MB of its packets, {share.socket_bytes / 1e6:.1f} MB are "
            "wanted: raise net.core.rmem_max."
        )

    def close(self, *, gone: bool = False) -> None:
        """Stop writing to slots, then stop and release the camera; `gone` releases it in the background."""
        if self._stream is not None:
            self._stream.close()
        # Aravis tries each access to an absent camera five times for 0.5 s (measured: 2.6 s), and closing makes
        # several.
        if gone:
            name = f"camera-{self.config.name}-remains"
            threading.Thread(target=self._release, args=(False,), name=name, daemon=True).start()
        else:
            self._release(True)

    def _release(self, stop: bool) -> None:
        with self._lock:
            if stop and self._stream is not None:
                with contextlib.suppress(glib_error()):  # a camera that has just gone cannot be stopped
                    self._camera.stop_acquisition()
            self._stream = self._camera = None
        # Aravis ends its threads and sockets with the last reference; PyGObject's wrappers may be in cycles.
        gc.collect()

    def _configure_packets(self, share: PortShare) -> None:
        camera, name = self._camera, self.config.label
        # Packet sockets need CAP_NET_RAW, and stopping their thread takes 24 ms and drops packets (decisions/0009).
        camera.gv_set_stream_options(aravis().GvStreamOption.PACKET_SOCKET_DISABLED)
        low, high = camera.get_integer_bounds("GevSCPSPacketSize")
        step = max(1, camera.get_integer_increment("GevSCPSPacketSize"))
        limits = network.PacketLimits(low, high, step)
        # Not Aravis' automatic size: it chose 12316 bytes at an MTU of 9000, which was 3 to 7 times slower (Aravis
        # #1065).
        size = network.packet_bytes(self.config.packet_bytes, network.mtu_to(self.identity.address), limits)
        settings.write_and_compare(
            name,
            Setting("GevSCPSPacketSize", size, lambda: camera.gv_set_packet_size(size), camera.gv_get_packet_size),
        )
        self.packet_bytes = size
        # Without gaps, cameras that share a link starve each other (Aravis #71, #710).
        delay = network.packet_delay_ns(size, share.cameras, share.link_mbit_s)
        if delay or camera.is_feature_available("GevSCPD"):
            tick_ns = 1e9 / (camera.get_device().get_timestamp_tick_frequency() or 1e9)
            settings.write_and_compare(
                name,
                Setting(
                    "GevSCPD (ns)",
                    delay,
                    lambda: camera.gv_set_packet_delay(delay),
                    camera.gv_get_packet_delay,
                    tick_ns,
                ),
            )

    def _identity(self, where: str) -> Identity:
        camera = self._camera
        address, interface = where, ""
        if self.is_gige:
            device = camera.get_device()
            address = device.get_device_address().get_address().to_string()
            interface = network.interface_of(device.get_interface_address().get_address().to_string())
        return Identity(
            vendor=camera.get_vendor_name() or "",
            model=camera.get_model_name() or "",
            serial=camera.get_device_serial_number() or "",
            address=address,
            interface=interface,
        )

    @contextlib.contextmanager
    def _device_access(self, trouble: str) -> Iterator[None]:
        """Hold the lock of the camera; turn GLib errors into DeviceErrors that name it."""
        with self._lock:
            if self._camera is None:
                raise DeviceError(f"{self.config.label}: is closed.", code="camera-lost")
            try:
                yield
            except (glib_error(), OSError) as error:  # OSError: the network interface has just gone
                raise DeviceError(
                    f"{self.config.label}: {trouble} ({settings.error_text(error)}).",
                    action="Check its cable and power; it is opened again automatically.",
                    code="camera-lost",
                ) from error


def check_silence(connections: list[Connection], settle_s: float = 0.15, watch_s: float = 0.4) -> None:
    """Check that no camera sends before the first pulse; DeviceError names the one that does."""
    # A trigger that was latched before the start of the acquisition yields one frame at once, which is no fault.
    time.sleep(settle_s)
    # No slot is queued yet, so the streams only count what arrives.
    before = [connection.traffic() for connection in connections]
    time.sleep(watch_s)
    for connection, count in zip(connections, before, strict=True):
        if connection.traffic() != count:
            raise DeviceError(
                f"{connection.config.label}: sends frames although no trigger was fired.",
                action="Check what its trigger input is wired to, and that nothing else triggers it.",
                code="camera-free-running",
            )
