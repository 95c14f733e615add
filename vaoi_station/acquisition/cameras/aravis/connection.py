"""One connection to one camera, found by address or serial number, from its opening to its loss.

In Aravis only pushing and popping of buffers is thread-safe: all other access is guarded by one lock. The host time of
a reading of the camera's clock is the middle of the round trip of its latch command.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from vaoi_station.acquisition.cameras.aravis import families, links, network, sequencer, settings
from vaoi_station.acquisition.cameras.aravis.discovery import FoundCamera, discover, usb_cameras
from vaoi_station.acquisition.cameras.aravis.features import Features
from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error, text_of, version
from vaoi_station.acquisition.cameras.aravis.network import PacketLimits
from vaoi_station.acquisition.cameras.aravis.sequencer import Sets
from vaoi_station.acquisition.cameras.aravis.settings import Setting, error_text
from vaoi_station.acquisition.cameras.aravis.stream import ChunkReader, FrameFormat, SlotResult, SlotStream
from vaoi_station.acquisition.cameras.interface import CameraLimits, CameraPtp
from vaoi_station.acquisition.clocks import ClockReading, timed_reading
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.optics.links import Sender, slowest_row
from vaoi_station.pixel_formats import PIXEL_FORMATS
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)


def find_clock(camera: Any, name: str) -> Callable[[], int]:
    """Return a function that reads the clock of a camera, ns."""
    device, features = camera.get_device(), Features(camera)
    for command, value in families.CLOCKS:
        # A category of the description may have the name of a clock (AVT_Mako_G234B: Timestamp).
        if features.has(command) and features.kind(value) in ("integer", "float") and features.has(value):
            # Aravis converts the time stamps of GigE frames by the same frequency; SFNC 2 counts ns.
            hertz = device.get_timestamp_tick_frequency() if command.startswith("Gev") or camera.is_gv_device() else 0
            return partial(_latch, device, command, value, 1e9 / hertz if hertz else 1.0)
    if camera.is_gv_device() and (hertz := device.get_timestamp_tick_frequency()):
        return partial(_latch_register, device, 1e9 / hertz)
    raise DeviceError(
        f"{name}: has no time stamp that can be latched ({', '.join(' or '.join(pair) for pair in families.CLOCKS)}).",
        action="Use a camera whose clock can be latched; without it, frames cannot be assigned to pulses.",
        code="clock-unknown",
    )


def _latch(device: Any, command: str, value: str, ns_per_tick: float) -> int:
    device.execute_command(command)
    ticks: int = device.get_integer_feature_value(value)
    return ticks if ns_per_tick == 1 else round(ticks * ns_per_tick)


def _latch_register(device: Any, ns_per_tick: float) -> int:
    return round(network.latched_ticks(device) * ns_per_tick)


OPENING_LOCK = threading.Lock()
"""Lock to hold while devices are searched or opened, because Aravis has one list of devices per process."""


def search() -> tuple[FoundCamera, ...]:
    """Return all cameras that reply to a search now. The search takes about two seconds."""
    library = aravis()
    library.update_device_list()
    listed = range(library.get_n_devices())
    usb = [k for k in listed if library.get_device_protocol(k) == "USB3Vision"]
    # GigE cameras are searched by our own datagrams, because Aravis lists only one of two cameras with the same name.
    return (
        *discover(),
        *(FoundCamera(library.get_device_serial_nbr(k) or "", library.get_device_id(k)) for k in usb),
    )


def locate(camera: CameraConfig) -> str:
    """Return the IP address or USB device id of a camera, which replies."""
    (place,) = locate_each([camera])
    if isinstance(place, VaoiError):
        raise place
    return place


def locate_each(cameras: Sequence[CameraConfig]) -> list[str | VaoiError]:
    """Return where each camera replies, or why it does not. One search covers all serial numbers."""
    found = search() if any(camera.address is None for camera in cameras) else ()
    places: list[str | VaoiError] = []
    for camera in cameras:
        try:
            places.append(_address_of(camera, found))
        except VaoiError as error:
            places.append(error)
    return places


def _address_of(config: CameraConfig, found: Sequence[FoundCamera]) -> str:
    if config.address is not None:
        # Aravis needs 1.0 to 2.5 s to fail for an absent address (measured).
        if not network.is_reachable(config.address):
            raise absence_error(config, config.address, "it does not answer")
        return config.address
    matching = [device.address for device in found if device.serial == config.serial]
    if not matching:
        there = ", ".join(f"{d.serial} at {d.address}" for d in found) or "none"
        raise DeviceError(
            f"{config.label}: no camera with serial number {config.serial!r} answers; cameras that answer: {there}.",
            action="Check its cable, its power and its serial number in station.toml.",
            code="camera-absent",
        )
    # A choice between them could give a camera the calibration of the other one.
    if len(matching) > 1:
        places = ", ".join(matching)
        raise InputError(
            f"{config.label}: {len(matching)} cameras have the serial number {config.serial!r} ({places}).",
            action="Give their addresses in station.toml instead of the serial number.",
            code="camera-ambiguous",
        )
    return matching[0]


def open_device(config: CameraConfig, address: str) -> Any:
    """Open the `Aravis.Camera` at an address (USB: a device id) and take control of it."""
    try:
        camera = aravis().Camera.new(address)
    except glib_error() as error:
        if network.is_ip(address) and network.is_reachable(address, tries=1):
            raise _description_error(config, address, error_text(error)) from error
        raise absence_error(config, address, error_text(error)) from error
    # `Camera.new` succeeds for a camera of another client; only `create_stream` would fail, with code 10 (measured).
    if camera.is_gv_device() and not camera.get_device().is_controller():
        raise DeviceError(
            f"{config.label}: another program{network.controlled_by(address)} controls the camera at {address}.",
            action="Close that program (the maker's viewer, another station); the camera is then opened automatically.",
            code="camera-in-use",
        )
    if camera.get_device().get_feature("AcquisitionStart") is None:
        raise _description_error(config, address, "it has no AcquisitionStart")
    return camera


def _description_error(config: CameraConfig, address: str, why: str) -> DeviceError:
    return DeviceError(
        f"{config.label}: the camera at {address} answers, but its description cannot be read ({why}).",
        action="Switch it off and on; if that does not help, update its firmware, or use another camera.",
        code="description-wrong",
    )


def find_packet_size(
    camera: Any, config: CameraConfig, limits: PacketLimits, address: str, local_address: str
) -> tuple[int, int | None]:
    """Return the largest packet that camera, MTU and station.toml permit, and the largest that came here in a test."""
    most = network.packet_bytes(config.packet_bytes, network.mtu_to(address), limits)
    return most, network.largest_passing(camera.get_device(), most, limits, local_address)


def absence_error(config: CameraConfig, address: str, why: str) -> DeviceError:
    """Return the error for a camera that does not reply at its address. `why` is the cause, a text in brackets."""
    trouble = network.route_trouble(address)
    return DeviceError(
        f"{config.label}: there is no camera at {address} ({why}).",
        action=f"Check its cable, its power and its address in station.toml{f'; {trouble}' if trouble else ''}.",
        code="camera-absent",
    )


USB3_MIN_VERSION = (0, 8, 30)
# Versions before 0.8.28 wait for USB3 data in a busy loop (Aravis #652). Version 0.8.29 corrected underruns (#568), and
# 0.8.30 sets the status of a buffer before the buffer is passed on.
RETENTION_US = 200_000
# Aravis' default of 100 ms lost the first frames after a pause (Aravis #818, #746).
PTP_LIMIT_S, PTP_PAUSE_S = 20.0, 0.2
"""Longest wait for a PTP master, and pause between two questions. A camera listens for 6 s by default, as announcements
come every 2 s and three may be lost, and is then calibrated."""
RESTART_PAUSE_S = 0.2
"""Pause between stop and start of an acquisition that is to begin anew."""
SLOWER = 1.05
"""Time of a frame, in rows of the start of the station, above which a camera is warned of."""
RESENT_PACKETS, RESENT_SHARE = 20, 0.001
"""Count and share of packets that were sent again above which a camera is warned of. A sound network loses none."""


@dataclass(frozen=True)
class Identity:
    """Serial number and address of a camera, and the port of this computer on which it replied."""

    serial: str
    address: str
    """IP address, or device id of a USB camera."""
    interface: str
    model: str = ""


@dataclass(frozen=True)
class PortShare:
    """What a camera gets of the links that it shares with others, and its receive buffer."""

    delay_ns: int = 0
    """Pause after each packet."""
    mbit_s: float | None = None
    """Its rate, for cameras that are paced by a limit and not by pauses; None: nothing limits it."""
    row_s: float | None = None
    """Time in which all cameras of the station send a row; None if it is not known."""
    socket_bytes: int = 0
    packet_bytes: int = 0
    """Size of its packets when the links were shared; 0 for USB."""


class Connection:
    """An open camera with its stream. Call `configure`, then `start`, and `close` at the end."""

    def __init__(self, config: CameraConfig, where: str, sequence: Sets = (), share: PortShare = PortShare()) -> None:
        """Open the camera at an address."""
        self.config, self.sequence, self.share = config, sequence, share
        self._exposure_known = True
        """Whether exposure and sequence of the camera are those of `config` and `sequence`, once it is configured."""
        self._camera: Any = open_device(config, where)
        self._lock = threading.Lock()
        self._stream: SlotStream | None = None
        self.is_gige = bool(self._camera.is_gv_device())
        self._doubtful_colours = ""
        self.packet_bytes = self._chunk_bytes = 0
        self.packets_proven = False
        """Whether a test packet of this size came here from the camera."""
        self._speed_mbit_s: float | None = None
        self._limit_mbit_s: float | None = None
        self._route_trouble = network.route_trouble(where) if self.is_gige else ""
        self.limits = CameraLimits()
        self.ptp: CameraPtp | None = None
        """What the camera has stated last; None without `ptp`."""
        self._clock_ns: Callable[[], int] | None = None
        self.granted_bytes = 0
        with self._device_access("does not report its identity"):
            self.identity = self._identity(where)
            self._thermometer = self._camera.get_device().is_feature_available("DeviceTemperature")

    def require_serial(self, serial: str | None) -> None:
        """Raise DeviceError if another serial number than this camera's is known of its place."""
        if serial and self.identity.serial != serial:
            raise DeviceError(
                f"{self.config.label}: at {self.identity.address} is the camera {self.identity.serial}, but until now "
                f"it was {serial}, to which calibration and flat fields belong.",
                action=f"Plug {serial} in again; or put {self.identity.serial} in its place on the page Cameras, or "
                "with `vaoi cameras replace`.",
                code="camera-other",
            )

    def measure_link(self) -> None:
        """Find the packet size of a GigE camera, and what it states of its link. It is not acquiring afterwards."""
        with self._device_access("does not state its link"):
            # An earlier program may have left the acquisition running, and a running camera locks its settings. The
            # error is ignored, because a camera that is not running may refuse the command.
            with contextlib.suppress(glib_error()):
                self._camera.stop_acquisition()
            if self.is_gige:
                self._find_packet_size()
                self._speed_mbit_s = links.speed_mbit_s(Features(self._camera), self.identity.address)

    @property
    def sender(self) -> Sender:
        """What the camera sends, and over which links."""
        place = self.identity.interface if self.is_gige else self.identity.serial
        speeds = [speed for speed in (self._speed_mbit_s, self._limit_mbit_s) if speed]
        return links.sender_of(self.config, place, min(speeds, default=None), self.packet_bytes or None)

    def link_text(self) -> str:
        """Return how the camera sends, for the log."""
        path = ", ".join(f"{k.name} {k.mbit_s:g} Mbit/s" if k.mbit_s else k.name for k in self.sender.path)
        proof = "by a test packet" if self.packets_proven else "by the MTU alone, without a test packet"
        packets = f"packets of {self.packet_bytes} bytes ({proof}), " if self.is_gige else ""
        own = f"{self.sender.own_mbit_s:g} Mbit/s of its own, " if self.sender.own_mbit_s else ""
        row = f"a row takes {self.share.row_s * 1e3:.1f} ms" if self.share.row_s else "time of a row unknown"
        return f"{self.config.label}: {packets}{own}{path or 'unknown link'}; {row}"

    def configure(self) -> None:
        """Write all settings and read them back. For a GigE camera, also set packet size and packet delay."""
        if not self.packet_bytes:
            self.measure_link()
        with self._device_access("does not take its settings"), self._noticing_restarts():
            self._doubtful_colours = settings.apply(self._camera, self.config)
            # Now, as PTP may change the unit in which the clock counts (Teledyne DALSA: "changes depending on the
            # Timestamp Source").
            self._clock_ns = find_clock(self._camera, self.config.label)
            if self.config.chunk_room_bytes:
                sequencer.switch_chunks_on(self._camera, self.config)
            if self.sequence:
                sequencer.program_sequencer(self._camera, self.config, self.sequence)
            self._configure_link()
            self.limits = settings.limits_of(self._camera)
            payload = self._camera.get_payload()
        self._chunk_bytes = payload - self.config.frame_bytes
        room = self.config.chunk_room_bytes
        if not (0 < self._chunk_bytes <= room or self._chunk_bytes == room == 0):
            chunks = f", and at most {room} bytes of chunk data are expected" if room else ""
            off = "further chunks off (ChunkEnable)" if room else "line padding off ([cameras.features])"
            raise DeviceError(
                f"{self.config.label}: sends frames of {payload} bytes, but {self.config.width}×{self.config.height} "
                f"px {self.config.pixel_format} are {self.config.frame_bytes}{chunks}.",
                action=f"Turn {off}, or correct width, height, format.",
                code="frame-size",
            )

    def set_exposure(self, wanted: CameraConfig, sequence: Sets = ()) -> None:
        """Write exposure and gain, and the sets of the sequencer, to the running camera, read them back and compare."""
        with self._device_access("does not take its exposure"):
            # A refusal half-way leaves some of the new values in the camera.
            self._exposure_known = False
            if not sequence and not self.sequence:
                settings.apply_exposure(self._camera, wanted)
            else:
                with self._acquisition_stopped():
                    sequencer.switch_sequencer_off(self._camera, wanted)
                    self.sequence = ()
                    if sequence:
                        sequencer.require_sequencer(self._camera, wanted, sequence)
                    settings.apply_exposure(self._camera, wanted)
                    if sequence:
                        try:
                            sequencer.program_sequencer(self._camera, wanted, sequence)
                        except DeviceError:
                            with contextlib.suppress(DeviceError):  # the first error says what is wrong
                                sequencer.switch_sequencer_off(self._camera, wanted)
                            raise
            self.config, self.sequence, self._exposure_known = wanted, sequence, True

    def has_exposure(self, wanted: CameraConfig, sequence: Sets) -> bool:
        """Whether the camera certainly has this exposure, gain and sequence; not after a refusal."""
        return self._exposure_known and (self.config, self.sequence) == (wanted, sequence)

    def rewind(self) -> None:
        """Let the next frame be exposed with the first set of the sequencer, if there is one."""
        if self.sequence:
            with self._device_access("does not begin its sequence anew"), self._acquisition_stopped():
                sequencer.rewind_sequencer(self._camera, self.config)

    @property
    def resettable(self) -> bool:
        """Whether the camera can be reset by a command."""
        with self._device_access("does not report its features"):
            return bool(self._camera.is_feature_available("DeviceReset"))

    def restart(self) -> None:
        """Stop and start the acquisition; the slots stay queued."""
        with self._device_access("cannot be started again"), self._acquisition_stopped():
            time.sleep(RESTART_PAUSE_S)

    def reset(self) -> None:
        """Let the camera begin anew, as after switching it on. It is away afterwards, with or without an answer."""
        with self._device_access("cannot be reset"), contextlib.suppress(glib_error()):
            self._camera.get_device().execute_command("DeviceReset")

    def start(self, on_slot: Callable[[SlotResult], None]) -> None:
        """Create the stream and start the acquisition. The stream calls `on_slot` when a frame has ended in a slot."""
        with self._device_access("cannot be started"):
            # No callback is given: it would run Python in Aravis' threads, which crashed (Aravis #453, #714, #941), and
            # it would stall reception while another thread holds the GIL.
            stream = self._camera.create_stream(None, None)
            if self.is_gige:
                stream.set_property("frame-retention", RETENTION_US)
                # The size is set and checked here, not by Aravis' property `socket-buffer`: the kernel may grant less
                # without an error (Aravis #894, #898), and the automatic mode with a small limit logs every frame
                # (#994).
                self.granted_bytes = network.widen_receive_buffer(stream.get_port(), self.share.socket_bytes)
            kind = FrameFormat(self.config.width, self.config.height, PIXEL_FORMATS[self.config.pixel_format].code)
            reader = ChunkReader(self._camera, self._chunk_bytes) if self._chunk_bytes else None
            named = text_of(self._camera.get_vendor_name), text_of(self._camera.get_model_name)
            name, misnumbers = f"camera-{self.config.name}", families.misnumbers_resends(*named)
            self._stream = SlotStream(stream, kind, on_slot, name, reader, misnumbers)
            self._camera.start_acquisition()

    @property
    def stream(self) -> SlotStream:
        """The stream to which slots are queued. It exists after `start`."""
        assert self._stream is not None
        return self._stream

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that receives frames; none before `start` and after `close`."""
        stream = self._stream  # read once: another thread may release the stream
        return () if stream is None else (stream.thread,)

    def counters(self) -> dict[str, int]:
        """Return the stream's counters by name. The dictionary is empty before `start` and after `close`."""
        stream = self._stream
        return {} if stream is None else stream.counters()

    def read_clock(self, epoch_ns: int) -> ClockReading:
        """Compare the camera's clock with the host's. Raise DeviceError if the camera does not reply."""
        with self._device_access("does not report its time"):
            clock_ns = self._clock_ns
            assert clock_ns is not None
            return timed_reading(lambda: (clock_ns() - epoch_ns) * 1e-9)

    def await_ptp(self, closing: threading.Event | None = None) -> None:
        """Wait until the clock of a camera with `ptp` is that of a master; go on without it after `PTP_LIMIT_S`."""
        # Clocks are set to a master's time before the camera says so. After that, a board would lose frames by it.
        closing, until_s = closing or threading.Event(), time.monotonic() + PTP_LIMIT_S
        self.read_ptp()
        while self.ptp and not self.ptp.synchronised and time.monotonic() < until_s and not closing.wait(PTP_PAUSE_S):
            self.read_ptp()
        if self.ptp and not self.ptp.synchronised and not closing.is_set():
            text = "%s: its clock follows no PTP master after %.0f s (state %s); it films with its own clock"
            _log.warning(text, self.config.label, PTP_LIMIT_S, self.ptp.state or "not stated")

    def read_ptp(self) -> None:
        """Ask a camera with `ptp` for its state. Raise DeviceError if it does not reply."""
        if not self.config.ptp:
            return
        with self._device_access("does not report its PTP"):
            before, self.ptp = self.ptp, settings.ptp_of(self._camera)
        if before is None or before.state != self.ptp.state:
            _log.info("%s: PTP state %s", self.config.label, self.ptp.state or "not stated")

    def temperature_c(self) -> float | None:
        """Return the camera's temperature; None if the camera has no thermometer."""
        if not self._thermometer:
            return None
        with self._device_access("does not report its temperature"):
            return float(self._camera.get_device().get_float_feature_value("DeviceTemperature"))

    def is_controller(self) -> bool:
        """Return whether this process still controls the camera, according to Aravis' last heartbeat."""
        return not self.is_gige or bool(self._camera.get_device().is_controller())

    def warning(self) -> str:
        """Return a warning if the set-up can lose frames under load, or colours are doubtful; else an empty text."""
        return " ".join(filter(None, (self._link_warning(), self._doubtful_colours)))

    def _link_warning(self) -> str:
        if not self.is_gige:
            found = version()
            return "" if found >= USB3_MIN_VERSION else f"Aravis {'.'.join(map(str, found))} is unreliable with USB3."
        if trouble := self._route_trouble:
            return f"Its packets may get lost: {trouble}."
        alone, row_s = slowest_row([self.sender]), self.share.row_s
        if row_s and alone.row_s > SLOWER * row_s:
            return (
                f"Its link has {alone.mbit_s:.0f} Mbit/s now, so that a frame takes {alone.row_s * 1e3:.0f} ms; a row "
                f"took {row_s * 1e3:.0f} ms when the station was started: check cable, plugs and switch."
            )
        if self.packet_bytes < self.share.packet_bytes:
            return (
                f"Only packets of {self.packet_bytes} bytes come from it now, of {self.share.packet_bytes} when the "
                "station was started: check the switches on the way, then restart the station."
            )
        if self.granted_bytes >= self.share.socket_bytes:
            return _resend_warning(self.counters())
        return (
            f"The kernel holds {self.granted_bytes / 1e6:.1f} MB of its packets, "
            f"{self.share.socket_bytes / 1e6:.1f} MB are wanted: raise net.core.rmem_max."
        )

    def close(self, *, gone: bool = False) -> None:
        """Stop writing to slots, then stop the camera and release it."""
        if self._stream is not None:
            self._stream.close()
        # Aravis tries each access to an absent camera five times for 0.5 s (measured: 2.6 s), and closing needs several
        # accesses. A caller must not wait for these.
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
            # The clock's function has the device: a camera that answers is free for others once that is dropped.
            self._stream = self._camera = self._clock_ns = None
        # Aravis ends its threads and sockets when the last reference to the camera is gone. The Python wrappers of
        # PyGObject may be in reference cycles, which only the garbage collector removes.
        gc.collect()

    @contextlib.contextmanager
    def _acquisition_stopped(self) -> Iterator[None]:
        """Stop the acquisition in a `with` block: a running camera locks its sequencer. Its stream keeps its slots."""
        self._camera.stop_acquisition()
        try:
            yield
        finally:
            self._camera.start_acquisition()

    def _find_packet_size(self) -> None:
        camera, address = self._camera, self.identity.address
        limits = PacketLimits.stated(Features(camera).limits("GevSCPSPacketSize"))
        local = camera.get_device().get_interface_address().get_address().to_string()
        most, passing = find_packet_size(camera, self.config, limits, address, local)
        self.packet_bytes, self.packets_proven = passing or most, passing is not None

    def _configure_link(self) -> None:
        camera, features = self._camera, Features(self._camera)
        tick_hz = camera.get_device().get_timestamp_tick_frequency() if self.is_gige else 0
        # Without gaps between packets, cameras on one link take the bandwidth from each other (Aravis #71, #710).
        ticks = links.pause_ticks(features, self.share.delay_ns, tick_hz) if self.is_gige else None
        self._limit_mbit_s = links.limit_throughput(features, self.share.mbit_s if ticks is None else None)
        if not self.is_gige:
            return
        # Packet sockets need CAP_NET_RAW, and stopping their thread takes 24 ms and drops packets (decisions/0009).
        camera.gv_set_stream_options(aravis().GvStreamOption.PACKET_SOCKET_DISABLED)
        # Else Aravis tests the size again when the stream is created, and may choose another one (Aravis #425, #1065).
        camera.gv_set_packet_size_adjustment(aravis().GvPacketSizeAdjustment.NEVER)
        if (size := network.set_packet_size(camera.get_device(), self.packet_bytes)) != self.packet_bytes:
            raise DeviceError(
                f"{self.config.label}: ignores a setting: its packets were set to {self.packet_bytes} bytes, but its "
                f"register reads {size}.",
                action="Set packet_bytes in station.toml to what it can do, or update its firmware.",
                code="setting-ignored",
            )
        if ticks is not None:
            settings.write(camera, self.config.label, [Setting("GevSCPD", ticks)])
        elif (
            self.share.delay_ns
            and self._limit_mbit_s is None
            and not network.set_pause(camera.get_device(), -(-self.share.delay_ns * tick_hz // 10**9))
        ):
            text = "%s: cannot pause for %d ns between its packets, and has no limit: packets may get lost on its link"
            _log.warning(text, self.config.label, self.share.delay_ns)

    def _identity(self, where: str) -> Identity:
        camera = self._camera
        address, interface, model = where, "", text_of(camera.get_model_name)
        serial = text_of(camera.get_device_serial_number).strip()  # as a search states it
        if self.is_gige:
            device = camera.get_device()
            address = device.get_device_address().get_address().to_string()
            interface = network.interface_of(device.get_interface_address().get_address().to_string())
            model = network.model_name(address) or model
        else:  # FLIR: 0138C343 at USB, which a search states, is 20497219 in the description (Aravis #492)
            serial = self.config.serial or serial
            model = next((usb.model for usb in usb_cameras() if usb.serial == serial), model)
        return Identity(serial, address, interface, model)

    @contextlib.contextmanager
    def _noticing_restarts(self) -> Iterator[None]:
        """Let an error in a `with` block say so if the camera has restarted meanwhile: its settings are lost then."""
        try:
            yield
        except DeviceError as error:
            if not self.is_gige or network.read_control(self.identity.address) is network.Control.CONTROLLED:
                raise
            why = error.message.removeprefix(f"{self.config.label}: ").rstrip(".")
            raise DeviceError(
                f"{self.config.label}: has restarted or gone while it was set up ({why}).",
                action="Check its power supply and cable; it is opened again automatically.",
                code="camera-lost",
            ) from error

    @contextlib.contextmanager
    def _device_access(self, trouble: str) -> Iterator[None]:
        """Hold the camera's lock in a `with` block. GLib errors in it become DeviceErrors that name the camera."""
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


def _resend_warning(counters: dict[str, int]) -> str:
    """Return a warning if many packets had to be sent again since the camera was opened; an empty text otherwise."""
    resent, received = counters.get("n_resent_packets", 0), counters.get("n_received_packets", 0)
    # Frames are complete nevertheless, so nothing else shows that the network loses packets.
    if resent < RESENT_PACKETS or resent < RESENT_SHARE * received:
        return ""
    return (
        f"{resent / received:.1%} of its packets were lost on the way and sent again: check cable and switch, and give "
        "its port fewer cameras or a faster link."
    )


def check_silence(connections: list[Connection], latched_s: float = 0.15, silence_s: float = 0.4) -> None:
    """Check that no camera sends frames before the first pulse."""
    # A trigger that a camera latched before the start of its acquisition yields one frame at once. That is no fault.
    time.sleep(latched_s)
    # No slot is queued yet, so the streams count arriving packets without storing them.
    before = [connection.counters() for connection in connections]
    # Nothing signals the absence of packets: only time can show it.
    time.sleep(silence_s)
    for connection, counters in zip(connections, before, strict=True):
        if connection.counters() != counters:
            raise DeviceError(
                f"{connection.config.label}: sends frames although no trigger was fired.",
                action="Check what its trigger input is wired to, and that nothing else triggers it.",
                code="camera-free-running",
            )
