"""A virtual GigE Vision camera: Aravis' own on one address of this machine; trigger, pictures and losses are ours.

    python -m vaoi_station.rig.devices.virtual_camera 127.0.0.2 SERIAL

GVCP and GVSP are real, the port is the standard's: one camera per address. stdin, one order per line:

    film PATH                          raw frames one behind the other, each as large as the client's payload;
                                       for the triggers from now on
    fire PICTURE STAMP LIGHT LOST      the trigger line rises: send this picture of the film (-1: darkness)

STAMP is the start of the exposure by the camera's clock in ns (CLOCK_REALTIME, as the fake has it; 0: now), LIGHT the
brightness relative to the film's, LOST the share of this frame's packets that are not sent. stdout says `ready
ADDRESS`, then of every frame `sent PICTURE ID`, and `ignored PICTURE` of a trigger that came while the camera was not
armed for it. The program ends with its standard input.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
import tempfile
import threading
from collections import deque
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.aravis.library import aravis, shared_library
from vaoi_station.errors import DeviceError, VaoiError
from vaoi_station.rig.devices.camera_description import wired
from vaoi_station.rig.devices.camera_orders import DARK, Order

POLL_HZ = 50.0
"""How often the fake looks at its trigger. It spins through the last millisecond of every interval: more costs CPU."""
BLACK_LEVEL = 2
"""Grey value without light, of 255."""
_MONO_16 = 0x01100007


class VirtualCamera:
    """One camera at one local address; it lives until the process ends."""

    def __init__(self, address: str, serial: str, tell: TextIO) -> None:
        """Serve at once.

        Raises:
            DeviceError: this machine has no such address, or another program serves GVCP there.
        """
        self._aravis, self._library = _aravis()
        self._tell, self._orders = tell, deque[tuple[Order, _Film]]()
        self._speaking = threading.Lock()
        self._film = _Film()
        self._server = self._serve(address, serial)
        self._fake = self._server.get_fake_camera()
        self._fake.set_trigger_frequency(POLL_HZ)
        self._fill = _FILL(self._paint)  # C keeps no reference
        self._library.arv_fake_camera_set_fill_pattern(hash(self._fake), self._fill, None)
        self.say(f"ready {address}")

    def obey(self, line: str) -> None:
        """One order."""
        word, *rest = line.split(maxsplit=1)
        if word == "film":
            self._film = _Film(Path(rest[0].rstrip("\n")))
        elif word == "fire":
            self._trigger(Order.of(line))
        else:
            raise ValueError(f"unknown order {line!r}")

    def say(self, line: str) -> None:
        """One line for whoever started us."""
        with self._speaking:
            self._tell.write(line + "\n")
            self._tell.flush()

    def _serve(self, address: str, serial: str) -> Any:
        plain = self._aravis.FakeCamera.new(serial).get_genicam_xml()
        text = plain[0] if isinstance(plain, tuple) else plain
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:  # read once, while it is made
            file.write(wired(text))
            file.flush()
            server = self._aravis.GvFakeCamera.new_full(address, serial, file.name)
        if not server.is_running():
            raise DeviceError(
                f"no camera can be served at {address}: the machine has no such address, or UDP port 3956 is in use.",
                action=f"ip addr add {address}/8 dev lo",
            )
        return server

    def _trigger(self, order: Order) -> None:
        if not self._armed():
            self.say(f"ignored {order.picture}")
            return
        self._orders.append((order, self._film))
        self._pull()

    def _pull(self) -> None:
        self._write("TRIGGER_SOFTWARE", 1)

    def _armed(self) -> bool:
        """A real camera forgets an edge that comes before AcquisitionStart; the fake would keep it."""
        return bool(
            self._fake.get_control_channel_privilege()
            and self._fake.get_acquisition_status()
            and self._fake.is_in_software_trigger_mode()
        )

    def _write(self, register: str, value: int) -> None:
        self._fake.write_register(getattr(self._aravis, f"FAKE_CAMERA_REGISTER_{register}"), value)

    def _paint(self, buffer: int, _: Any, _exposure_us: int, _gain: int, pixel_format: int) -> None:
        """In the server's thread, before the frame's first packet."""
        order, film = self._orders.popleft() if self._orders else (Order(DARK), self._film)  # running freely
        unused = ctypes.c_size_t()  # nothing has been "received" yet
        address = self._library.arv_buffer_get_data(buffer, ctypes.byref(unused))
        size = self._fake.get_payload()
        target = np.ctypeslib.as_array((ctypes.c_ubyte * size).from_address(address))
        target[:] = film.picture(order.picture, order.light, size, pixel_format)
        self._server.set_property("gvsp-lost-ratio", order.lost)
        if order.stamp_ns:
            self._library.arv_buffer_set_timestamp(buffer, order.stamp_ns)
        if self._orders:  # two edges within one look at the register
            self._pull()
        self.say(f"sent {order.picture} {self._library.arv_buffer_get_frame_id(buffer)}")


class _Film:
    """Frames in a file, mapped; without a file all is dark."""

    def __init__(self, path: Path | None = None) -> None:
        self._bytes: NDArray[np.uint8] = np.zeros(0, np.uint8)
        if path is not None:
            with path.open("rb") as file:
                self._bytes = np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)

    def picture(self, number: int, light: float, size: int, pixel_format: int) -> NDArray[np.uint8]:
        """The bytes of a frame, (size,), under more or less light than it was filmed with."""
        first = number * size
        if number < 0 or first + size > len(self._bytes):
            return lit(np.zeros(size, np.uint8), 0.0, pixel_format)
        return lit(self._bytes[first : first + size], light, pixel_format)


def lit(pixels: NDArray[np.uint8], light: float, pixel_format: int) -> NDArray[np.uint8]:
    """The flat bytes of a frame under other light: what is above the black level is multiplied, then clipped.

    Args:
        pixels: flat bytes, Mono8 or little-endian Mono16.
        light: 1 leaves them as they are, 0 is darkness.
        pixel_format: GenICam's number.
    """
    if light == 1:
        return pixels
    scale = 256 if pixel_format == _MONO_16 else 1
    values = np.arange(256 * scale, dtype=np.float32)
    black = np.float32(BLACK_LEVEL * scale)
    table = np.clip(np.rint(black + (values - black) * np.float32(light)), 0, 256 * scale - 1)
    kind = np.dtype("<u2") if scale > 1 else np.dtype("u1")
    return np.asarray(table.astype(kind)[pixels.view(kind)]).view(np.uint8)


_FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
"""void (ArvBuffer *, void *, exposure in us, gain, pixel format)"""


def _aravis() -> tuple[Any, ctypes.CDLL]:
    """Its binding, and the library itself: the binding of the fill pattern crashes before 0.9.1."""
    library = shared_library()
    library.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, _FILL, ctypes.c_void_p]
    library.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
    library.arv_buffer_get_data.restype = ctypes.c_void_p
    library.arv_buffer_set_timestamp.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
    library.arv_buffer_get_frame_id.argtypes = [ctypes.c_void_p]
    library.arv_buffer_get_frame_id.restype = ctypes.c_uint64
    return aravis(), library


def main(address: str, serial: str) -> int:
    """Serve until standard input ends."""
    try:
        camera = VirtualCamera(address, serial, sys.stdout)
    except VaoiError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    for line in sys.stdin:
        camera.obey(line)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
