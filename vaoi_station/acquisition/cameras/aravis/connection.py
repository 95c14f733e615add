"""One connection to one camera, from opening to loss; nothing of it is used again.

Aravis lets one thread at a time use a device, so everything that asks the camera goes through one lock; the stream has
its own thread and needs none.
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
"""Older versions of Aravis wait for USB3 cameras in a busy loop, or mistake their states."""
RETENTION_US = 200_000
"""How long Aravis waits for the rest of a frame."""


@dataclass(frozen=True)
class Identity:
    """Who answered."""

    vendor: str
    model: str
    serial: str
    address: str
    """IP address, or device id of a USB camera."""
    interface: str
    """Port of this computer; empty for USB."""


@dataclass(frozen=True)
class PortShare:
    """A camera's part of its port."""

    cameras: int = 1
    """That share the port, itself included."""
    link_mbit_s: float | None = None
    socket_bytes: int = 0
    """Wanted of the kernel for its packets."""


class Connection:
    """An open camera; `configure`, then `start`, then `close`."""

    def __init__(self, config: CameraConfig, where: str) -> None:
        """Open it.

        Raises:
            DeviceError: absent, or in use by somebody else.
        """
        self.config = config
        self._camera: Any = open_device(config, where)
        self._lock = threading.Lock()
        self._stream: SlotStream | None = None
        self.is_gige = bool(self._camera.is_gv_device())
        self.packet_bytes = 0
        self.granted_bytes = 0
        """What the kernel holds of its packets while nobody reads them."""
        with self._device_access("does not say who it is"):
            self.identity = self._identity(where)
            self._clock = find_clock(self._camera, config.label)
            self._thermometer = self._camera.get_device().is_feature_available("DeviceTemperature")

    def configure(self, share: PortShare) -> None:
        """All settings, read back; for GigE the packets too.

        Raises:
            DeviceError: refused or ignored settings, a frame of another size than the slots of the ring.
        """
        with self._device_access("does not take its settings"):
            with contextlib.suppress(glib_error()):  # whoever had it before may have left it filming, settings locked
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
        """Make the stream and let the camera wait for its trigger; `told` of every slot that comes back.

        Raises:
            DeviceError: the stream cannot be made.
        """
        with self._device_access("cannot be started"):
            stream = self._camera.create_stream(None, None)
            if self.is_gige:
                stream.set_property("frame-retention", RETENTION_US)
                self.granted_bytes = network.widen_receive_buffer(stream.get_port(), share.socket_bytes)
            kind = FrameFormat(self.config.width, self.config.height, PIXEL_FORMATS[self.config.pixel_format].code)
            self._stream = SlotStream(stream, kind, on_slot, f"camera-{self.config.name}")
            self._camera.start_acquisition()

    @property
    def stream(self) -> SlotStream:
        """Where slots are queued, once started."""
        assert self._stream is not None
        return self._stream

    def counters(self) -> dict[str, int]:
        """The stream's own counters by name; none once closed."""
        stream = self._stream
        return {} if stream is None else stream.counters()

    def traffic(self) -> int:
        """A number that grows when the camera sends anything."""
        return sum(self.counters().values())

    def read_clock(self, epoch_ns: int) -> ClockReading:
        """Camera against host; seconds since the epoch. DeviceError if it does not answer."""
        if not self._clock.remote:
            return self._clock.read(epoch_ns)
        with self._device_access("does not tell its time"):
            return self._clock.read(epoch_ns)

    def temperature_c(self) -> float | None:
        """None where there is no thermometer."""
        if not self._thermometer:
            return None
        with self._device_access("does not tell its temperature"):
            return float(self._camera.get_device().get_float_feature_value("DeviceTemperature"))

    def is_controller(self) -> bool:
        """Whether we still control the camera."""
        return not self.is_gige or bool(self._camera.get_device().is_controller())

    def warning(self, share: PortShare) -> str:
        """What does not forbid to film, but will lose frames on a bad day; empty if all is well."""
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
        """Nothing is written to slots any more; then the camera is stopped and let go of.

        Of a camera that is gone nobody waits for the second: Aravis asks it several times five half seconds whether it
        would not stop.
        """
        if self._stream is not None:
            self._stream.close()
        if gone:
            name = f"camera-{self.config.name}-remains"
            threading.Thread(target=self._release, args=(False,), name=name, daemon=True).start()
        else:
            self._release(True)

    def _release(self, stop: bool) -> None:
        with self._lock:
            if stop and self._stream is not None:
                with contextlib.suppress(glib_error()):  # a camera that does not answer cannot be stopped
                    self._camera.stop_acquisition()
            self._stream = self._camera = None
        gc.collect()  # Aravis' threads and sockets end with the last reference

    def _configure_packets(self, share: PortShare) -> None:
        camera, name = self._camera, self.config.label
        camera.gv_set_stream_options(aravis().GvStreamOption.PACKET_SOCKET_DISABLED)
        low, high = camera.get_integer_bounds("GevSCPSPacketSize")
        step = max(1, camera.get_integer_increment("GevSCPSPacketSize"))
        limits = network.PacketLimits(low, high, step)
        size = network.packet_bytes(self.config.packet_bytes, network.mtu_to(self.identity.address), limits)
        settings.write_and_compare(
            name,
            Setting("GevSCPSPacketSize", size, lambda: camera.gv_set_packet_size(size), camera.gv_get_packet_size),
        )
        self.packet_bytes = size
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
        """The camera is asked by one thread at a time; its refusals become errors that name it."""
        with self._lock:
            if self._camera is None:
                raise DeviceError(f"{self.config.label}: is closed.", code="camera-lost")
            try:
                yield
            except (glib_error(), OSError) as error:  # OSError: the interface has just gone
                raise DeviceError(
                    f"{self.config.label}: {trouble} ({settings.error_text(error)}).",
                    action="Check its cable and power; it is opened again by itself.",
                    code="camera-lost",
                ) from error


def check_silence(connections: list[Connection], settle_s: float = 0.15, watch_s: float = 0.4) -> None:
    """After the acquisition has been started and before the first pulse nothing may come; DeviceError names who sends.

    A trigger that was latched before may still yield one frame at once; it is let pass. Nothing but time shows silence:
    no slot is queued yet, so the streams count what comes and tell nobody.
    """
    time.sleep(settle_s)
    before = [connection.traffic() for connection in connections]
    time.sleep(watch_s)
    for connection, count in zip(connections, before, strict=True):
        if connection.traffic() != count:
            raise DeviceError(
                f"{connection.config.label}: sends frames although no trigger was fired.",
                action="Check what its trigger input is wired to, and that nothing else triggers it.",
                code="camera-free-running",
            )
