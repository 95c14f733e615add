"""The process of a virtual GigE Vision camera: frames from a file for triggers on standard input.

    python -m vaoi_station.rig.virtual_camera 127.0.0.2 SERIAL WIDTH HEIGHT [DESCRIPTION]

WIDTH and HEIGHT are those of its sensor; DESCRIPTION is a file with its GenICam description. Standard input takes one
command per line:

    film PATH                          raw frames in one file, each as large as the client's payload;
                                       used by the triggers that follow
    fire PICTURE STAMP LIGHT LOST WIDE a rising edge of the trigger line: send this picture of the file (-1: black)

STAMP is the time of the edge, ns of CLOCK_MONOTONIC (0: now). LIGHT is a factor on the brightness; WIDE is that in
the ExposureMode TriggerWidth, or None for the same. LOST is the share of the packets that are not sent, neither when
the client asks for them again. Standard output has `ready ADDRESS`, then `sent PICTURE ID` for every frame, and
`ignored PICTURE` for a trigger that came while no client had armed the camera. The program ends at the end of its
standard input.
"""

from __future__ import annotations

import gzip
import mmap
import random
import sys
import threading
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.rig.camera_process import TriggerCommand
from vaoi_station.rig.gige.camera import Camera, as_it_is
from vaoi_station.rig.gige.description import Description, DescriptionError
from vaoi_station.rig.gige.first_values import Sensor

OWN_DESCRIPTION = Path(__file__).with_name("gige") / "camera.xml"
BLACK_LEVEL = 2
FIRST_ID = 65_400
"""Of the first frame: soon before the numbers begin again, so that this happens in runs of more than 136 frames."""
_MONO_16 = 0x01100007


def read_description(path: Path) -> str:
    """Read a GenICam description, .xml or .xml.gz."""
    try:
        content = path.read_bytes()
        text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode("utf-8-sig")
        Description(text)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, DescriptionError) as error:
        raise InputError(
            f"{path}: cannot be read as the description of a camera: {error}",
            action="Give the GenICam file of a camera, as XML or packed by gzip.",
        ) from error
    return text


class VirtualCamera:
    """One virtual camera at one local address. It serves its clients until the process ends."""

    def __init__(
        self, address: str, serial: str, sensor: Sensor, output: TextIO, description: str | None = None
    ) -> None:
        """Start to serve GVCP and GVSP at the address, and write the line `ready` to `output`."""
        self._output, self._reporting = output, threading.Lock()
        self._frames = _FrameFile()
        self._random = random.Random(serial)
        text = read_description(OWN_DESCRIPTION) if description is None else description
        try:
            self.camera = Camera(address, text, serial=serial, sensor=sensor)
        except OSError as error:
            raise DeviceError(
                f"no camera can be served at {address}: {error.strerror} (is UDP port 3956 in use?).",
                action=f"ip addr add {address}/8 dev lo",
            ) from error
        self.camera.next_id = FIRST_ID
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

    def _trigger(self, command: TriggerCommand) -> None:
        camera = self.camera
        brightness = command.brightness
        if command.by_width is not None and camera.offers("ExposureMode"):
            brightness = command.by_width if camera.value("ExposureMode") == "TriggerWidth" else brightness
        pixels = self._frames.picture(command.picture, brightness, camera.payload_bytes, camera.stream.pixel_format)

        def without_lost(packets: list[bytes]) -> Sequence[bytes]:
            count = min(max(round(command.lost_share * len(packets)), 1), len(packets))
            lost = frozenset(self._random.sample(range(len(packets)), count))
            return [packet for k, packet in enumerate(packets) if k not in lost]

        loses = command.lost_share > 0
        camera.resend_script = (lambda _packets: ()) if loses else as_it_is
        number = camera.expose(pixels.data, without_lost if loses else as_it_is, command.timestamp_ns or None)
        self.report(f"sent {command.picture} {number}" if number else f"ignored {command.picture}")


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


def main(address: str, serial: str, width: str, height: str, description: str | None = None) -> int:
    """Serve a camera until the end of standard input; return the exit code of the process."""
    # CameraProcess reads the message from standard error and shows it to the user.
    try:
        text = read_description(Path(description)) if description else None
        camera = VirtualCamera(address, serial, Sensor(int(width), int(height)), sys.stdout, text)
    except VaoiError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    for line in sys.stdin:
        camera.execute(line)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
