"""A virtual GigE Vision camera: Aravis' fake camera with a hardware trigger, given frames and packet loss.

    python -m vaoi_station.rig.virtual_camera 127.0.0.2 SERIAL

Standard input takes one command per line:

    film PATH                          raw frames in one file, each as large as the client's payload;
                                       used by the triggers that follow
    fire PICTURE STAMP LIGHT LOST WIDE a rising edge of the trigger line: send this picture of the file (-1: black)

STAMP is the start of the exposure, ns of CLOCK_REALTIME (0: now). LIGHT is a factor on the brightness; WIDE is that in
the ExposureMode TriggerWidth, or None for the same. LOST is the share of the packets that are not sent. Standard output
has `ready ADDRESS`, then `sent PICTURE ID` for every frame, and `ignored PICTURE` for a trigger that came while no
client had armed the camera. The program ends at the end of its standard input.

The fake accepts a trigger only while its source register holds the number of *Software*. So the numbers of *Line0* and
*Software* are exchanged in its GenICam description: a client that selects Line0 has selected what the rig triggers.
"""

from __future__ import annotations

import ctypes
import mmap
import re
import sys
import tempfile
import threading
from collections import deque
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.aravis.library import aravis, shared_library
from vaoi_station.errors import DeviceError, InternalError, VaoiError
from vaoi_station.rig.camera_process import DARK, TriggerCommand

_ENTRY = re.compile(r'(<EnumEntry Name="([^"]*)"[^>]*>.*?<Value>)(\d+)', re.DOTALL)
_TEMPERATURE = """
	<Float Name="DeviceTemperature" NameSpace="Standard">
		<DisplayName>Device Temperature</DisplayName>
		<Value>{celsius}</Value>
		<Unit>C</Unit>
	</Float>
"""

EXPOSURE_MODE_ADDRESS = 0x9000
"""Address of the register that holds the ExposureMode, in the fake's memory beyond its own registers."""
TIMED, TRIGGER_WIDTH = 0, 1
_EXPOSURE_MODE = f"""
	<Enumeration Name="ExposureMode" NameSpace="Standard">
		<DisplayName>Exposure Mode</DisplayName>
		<EnumEntry Name="Timed" NameSpace="Standard"><Value>{TIMED}</Value></EnumEntry>
		<EnumEntry Name="TriggerWidth" NameSpace="Standard"><Value>{TRIGGER_WIDTH}</Value></EnumEntry>
		<pValue>ExposureModeRegister</pValue>
	</Enumeration>
	<IntReg Name="ExposureModeRegister" NameSpace="Custom">
		<Address>{EXPOSURE_MODE_ADDRESS}</Address>
		<Length>4</Length>
		<AccessMode>RW</AccessMode>
		<pPort>Device</pPort>
		<Sign>Unsigned</Sign>
		<Endianess>BigEndian</Endianess>
	</IntReg>
"""


def with_line0_trigger(description: str, celsius: float = 41.5) -> str:
    """Return the fake's GenICam description with Line0 as trigger source, a temperature and ExposureMode."""
    sources = re.search(r'<Enumeration Name="TriggerSource".*?</Enumeration>', description, re.DOTALL)
    numbers = {entry[2]: entry[3] for entry in _ENTRY.finditer(sources[0])} if sources is not None else {}
    if sources is None or not {"Line0", "Software"} <= numbers.keys():
        raise InternalError("Aravis' fake camera has no trigger source Line0 or Software.")
    exchanged = numbers | {"Line0": numbers["Software"], "Software": numbers["Line0"]}
    inside = _ENTRY.sub(lambda entry: entry[1] + exchanged[entry[2]], sources[0])
    added = _TEMPERATURE.format(celsius=celsius) + _EXPOSURE_MODE + "</RegisterDescription>"
    return (description[: sources.start()] + inside + description[sources.end() :]).replace(
        "</RegisterDescription>", added
    )


POLL_HZ = 50.0
"""Frequency at which Aravis' fake camera polls its trigger register. A higher frequency costs CPU time, because the
fake waits in a busy loop during the last millisecond of each interval.
"""
BLACK_LEVEL = 2
_MONO_16 = 0x01100007


class VirtualCamera:
    """One virtual camera at one local address. It serves its clients until the process ends."""

    def __init__(self, address: str, serial: str, output: TextIO) -> None:
        """Start to serve GVCP and GVSP at the address, and write the line `ready` to `output`."""
        self._aravis, self._library = _aravis()
        self._output, self._commands = output, deque[tuple[TriggerCommand, _FrameFile]]()
        self._reporting = threading.Lock()
        self._frames = _FrameFile()
        self._server = self._serve(address, serial)
        self._fake = self._server.get_fake_camera()
        self._fake.set_trigger_frequency(POLL_HZ)
        # The C library keeps no reference to the callback. Without this attribute Python would free it.
        self._fill = _FILL(self._fill_buffer)
        self._library.arv_fake_camera_set_fill_pattern(hash(self._fake), self._fill, None)
        self.report(f"ready {address}")

    def execute(self, line: str) -> None:
        """Execute one command line; the module's description lists the commands."""
        word, *rest = line.split(maxsplit=1)
        if word == "film":
            self._frames = _FrameFile(Path(rest[0].rstrip("\n")))
        elif word == "fire":
            self._trigger(TriggerCommand.from_line(line))
        else:
            raise ValueError(f"unknown command {line!r}")

    def report(self, line: str) -> None:
        """Write one report line to the process that started this camera."""
        with self._reporting:
            self._output.write(line + "\n")
            self._output.flush()

    def _serve(self, address: str, serial: str) -> Any:
        plain = self._aravis.FakeCamera.new(serial).get_genicam_xml()
        text = plain[0] if isinstance(plain, tuple) else plain
        # The fake camera reads this file once, in its constructor. Afterwards the file may be deleted.
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
            file.write(with_line0_trigger(text))
            file.flush()
            server = self._aravis.GvFakeCamera.new_full(address, serial, file.name)
        if not server.is_running():
            raise DeviceError(
                f"no camera can be served at {address}: the machine has no such address, or UDP port 3956 is in use.",
                action=f"ip addr add {address}/8 dev lo",
            )
        return server

    def _trigger(self, command: TriggerCommand) -> None:
        if not self._armed():
            self.report(f"ignored {command.picture}")
            return
        self._commands.append((command, self._frames))
        self._fire()

    def _fire(self) -> None:
        self._write("TRIGGER_SOFTWARE", 1)

    def _armed(self) -> bool:
        """Whether a client has armed the camera for the hardware trigger.

        A real camera ignores a trigger edge before AcquisitionStart. Aravis' fake camera would keep the edge and send a
        frame later.
        """
        return bool(
            self._fake.get_control_channel_privilege()
            and self._fake.get_acquisition_status()
            and self._fake.is_in_software_trigger_mode()
        )

    def _exposes_by_width(self) -> bool:
        """Whether the client has selected the exposure mode TriggerWidth."""
        return bool(self._fake.read_register(EXPOSURE_MODE_ADDRESS)[1] == TRIGGER_WIDTH)

    def _write(self, register: str, value: int) -> None:
        self._fake.write_register(getattr(self._aravis, f"FAKE_CAMERA_REGISTER_{register}"), value)

    def _fill_buffer(self, buffer: int, _: Any, _exposure_us: int, _gain: int, pixel_format: int) -> None:
        """Fill the buffer of a frame. The server's thread calls this method before it sends the first packet."""
        # A frame without a command means that the client lets the camera run freely; such frames are black.
        command, frames = self._commands.popleft() if self._commands else (TriggerCommand(DARK), self._frames)
        # `arv_buffer_get_data` reports a size of 0 before the frame is sent, so the payload gives the size.
        unused = ctypes.c_size_t()
        address = self._library.arv_buffer_get_data(buffer, ctypes.byref(unused))
        size = self._fake.get_payload()
        target = np.ctypeslib.as_array((ctypes.c_ubyte * size).from_address(address))
        by_width = command.by_width is not None and self._exposes_by_width()
        brightness = command.by_width if by_width and command.by_width is not None else command.brightness
        target[:] = frames.picture(command.picture, brightness, size, pixel_format)
        self._server.set_property("gvsp-lost-ratio", command.lost_share)
        if command.timestamp_ns:
            self._library.arv_buffer_set_timestamp(buffer, command.timestamp_ns)
        # Two edges between two polls set the trigger register only once, so the second frame is fired from here.
        if self._commands:
            self._fire()
        self.report(f"sent {command.picture} {self._library.arv_buffer_get_frame_id(buffer)}")


class _FrameFile:
    """Frames in a memory-mapped file, one after another. Without a file all frames are black."""

    def __init__(self, path: Path | None = None) -> None:
        self._bytes: NDArray[np.uint8] = np.zeros(0, np.uint8)
        if path is not None:
            with path.open("rb") as file:
                self._bytes = np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)

    def picture(self, number: int, brightness: float, size: int, pixel_format: int) -> NDArray[np.uint8]:
        """Return the bytes of a frame, (size,), with scaled brightness; black if the file has no such picture."""
        first = number * size
        if number < 0 or first + size > len(self._bytes):
            return apply_brightness(np.zeros(size, np.uint8), 0.0, pixel_format)
        return apply_brightness(self._bytes[first : first + size], brightness, pixel_format)


def apply_brightness(pixels: NDArray[np.uint8], brightness: float, pixel_format: int) -> NDArray[np.uint8]:
    """Return pixels whose grey values above the black level are scaled, rounded and clipped."""
    if brightness == 1:
        return pixels
    scale = 256 if pixel_format == _MONO_16 else 1
    values = np.arange(256 * scale, dtype=np.float32)
    black = np.float32(BLACK_LEVEL * scale)
    # A lookup table is faster than arithmetic on every pixel, and cameras share the CPU cores with the station.
    table = np.clip(np.rint(black + (values - black) * np.float32(brightness)), 0, 256 * scale - 1)
    kind = np.dtype("<u2") if scale > 1 else np.dtype("u1")
    return np.asarray(table.astype(kind)[pixels.view(kind)]).view(np.uint8)


_FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
"""C type of the callback: void (ArvBuffer *, void *, exposure in us, gain, pixel format)."""


def _aravis() -> tuple[Any, ctypes.CDLL]:
    """Return the Python binding of Aravis, and its C library with declared argument types."""
    # PyGObject's set_fill_pattern crashes before Aravis 0.9.1; through ctypes the function works.
    library = shared_library()
    library.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, _FILL, ctypes.c_void_p]
    library.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
    library.arv_buffer_get_data.restype = ctypes.c_void_p
    library.arv_buffer_set_timestamp.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
    library.arv_buffer_get_frame_id.argtypes = [ctypes.c_void_p]
    library.arv_buffer_get_frame_id.restype = ctypes.c_uint64
    return aravis(), library


def main(address: str, serial: str) -> int:
    """Serve a camera until the end of standard input; return the exit code of the process."""
    # CameraProcess reads the message from standard error and shows it to the user.
    try:
        camera = VirtualCamera(address, serial, sys.stdout)
    except VaoiError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    for line in sys.stdin:
        camera.execute(line)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
