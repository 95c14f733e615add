"""The virtual rig's camera, with faults that a test chooses.

    python device.py ADDRESS SERIAL [CHANGE …]

Changes are made to the description that the camera serves, before it is served. Two commands are added to those of the
rig: `width N`, by which the camera changes its region without a request, and `release`, after which it reports no
controlling application, as after missed heartbeats.
"""

from __future__ import annotations

import ctypes
import re
import sys
import threading
import time
from functools import reduce

from vaoi_station.acquisition.cameras.aravis.library import shared_library
from vaoi_station.pixel_formats import PIXEL_FORMATS
from vaoi_station.rig import virtual_camera as camera
from vaoi_station.rig.virtual_camera import with_line0_trigger

PRIVILEGE_REGISTER = 0x0A00
CLOCK_ADDRESS = 0x8000
CLOCK_AHEAD_NS = 4_000_000_000_000
"""Of a latched clock before the host's monotonic one."""


def formats(text: str) -> str:
    """Offer all pixel formats; the fake has seven."""
    entries = "".join(
        f'<EnumEntry Name="{name}"><Value>{known.code}</Value></EnumEntry>'
        for name, known in PIXEL_FORMATS.items()
        if f'Name="{name}"' not in text
    )
    return re.sub(r'(<Enumeration Name="PixelFormat".*?)(<pValue>)', rf"\1{entries}\2", text, count=1, flags=re.DOTALL)


def stubborn(text: str) -> str:
    """Expose for 5 ms whatever exposure is set."""
    return re.sub(
        r"<FormulaTo>FROM</FormulaTo>(?=\s*<FormulaFrom>TO</FormulaFrom>\s*<pValue>ExposureTimeAbsRegister)",
        "<FormulaTo>FROM * 0 + 5000</FormulaTo>",
        text,
    )


def free_running(text: str) -> str:
    """Report that the trigger is on while it is off."""
    head, mode, rest = re.split(
        r'(<Enumeration Name="TriggerMode".*?</Enumeration>)', text, maxsplit=1, flags=re.DOTALL
    )
    swapped = mode.replace("<Value>0<", "<Value>2<").replace("<Value>1<", "<Value>0<").replace("<Value>2<", "<Value>1<")
    return head + swapped + rest


def latch(text: str) -> str:
    """Add a clock that can be latched; its value is at most a millisecond old."""
    return text.replace(
        "</RegisterDescription>",
        '<Command Name="TimestampLatch"><pValue>LatchRegister</pValue><CommandValue>1</CommandValue></Command>'
        f'<IntReg Name="LatchRegister"><Address>{CLOCK_ADDRESS + 8}</Address><Length>4</Length>'
        "<AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        f'<IntReg Name="TimestampLatchValue"><Address>{CLOCK_ADDRESS}</Address><Length>8</Length>'
        "<AccessMode>RO</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        "</RegisterDescription>",
    )


CHANGES = {change.__name__: change for change in (formats, stubborn, free_running, latch)}


class Device(camera.VirtualCamera):
    """A camera with further commands."""

    def execute(self, line: str) -> None:
        if line.startswith("width "):
            self._write("WIDTH", int(line.split()[1]))
            self.report("done")
        elif line.strip() == "release":
            self._fake.write_register(PRIVILEGE_REGISTER, 0)
            self.report("done")
        else:
            super().execute(line)

    def tick(self, over: threading.Event) -> None:
        """Let the clock run until the end of the program."""
        library = shared_library()
        library.arv_fake_camera_write_memory.argtypes = [
            ctypes.c_void_p,
            ctypes.c_uint32,
            ctypes.c_uint32,
            ctypes.c_char_p,
        ]
        while not over.wait(0.0005):
            now = (time.monotonic_ns() + CLOCK_AHEAD_NS).to_bytes(8, "big")
            library.arv_fake_camera_write_memory(hash(self._fake), CLOCK_ADDRESS, 8, now)


def main(address: str, serial: str, *changes: str) -> None:
    def changed(text: str) -> str:
        return reduce(lambda so_far, name: CHANGES[name](so_far), changes, with_line0_trigger(text))

    vars(camera)["with_line0_trigger"] = changed
    device = Device(address, serial, sys.stdout)
    over = threading.Event()
    if "latch" in changes:
        threading.Thread(target=device.tick, args=(over,)).start()
    try:
        for line in sys.stdin:
            device.execute(line)
    finally:
        over.set()


if __name__ == "__main__":
    main(*sys.argv[1:])
