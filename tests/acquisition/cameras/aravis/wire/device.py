"""The virtual rig's camera, with faults that a test chooses.

    python device.py ADDRESS SERIAL [CHANGE …]

A command is added to those of the rig: `release`, after which the camera has no controlling application, as after
missed heartbeats.
"""

from __future__ import annotations

import re
import sys
import threading

from vaoi_station.pixel_formats import PIXEL_FORMATS
from vaoi_station.rig.gige.first_values import Sensor
from vaoi_station.rig.virtual_camera import OWN_DESCRIPTION, VirtualCamera, read_description

SENSOR = Sensor(640, 480)


def all_formats(text: str) -> str:
    """Offer all pixel formats; the rig's camera has two."""
    entries = "".join(
        f'<EnumEntry Name="{name}"><Value>{known.code}</Value></EnumEntry>'
        for name, known in PIXEL_FORMATS.items()
        if f'Name="{name}"' not in text
    )
    return re.sub(r'(<Enumeration Name="PixelFormat".*?)(<pValue>)', rf"\1{entries}\2", text, count=1, flags=re.DOTALL)


class Device(VirtualCamera):
    """A camera with a further command."""

    def execute(self, line: str) -> None:
        if line.strip() == "release":
            with self.camera.lock:
                self.camera.release()
            self.report("done")
        else:
            super().execute(line)

    def run_freely(self, over: threading.Event) -> None:
        """Send frames without a trigger until the end of the program."""
        while not over.wait(0.02):
            self.camera.expose(bytes(self.camera.payload_bytes))


def main(address: str, serial: str, *changes: str) -> None:
    text = read_description(OWN_DESCRIPTION)
    if "formats" in changes:
        text = all_formats(text)
    if "sizeless" in changes:
        text = re.sub(r"<pMax>Sensor\w+</pMax>", "<Max>640</Max>", text).replace("Sensor", "Other")
    device = Device(address, serial, SENSOR, sys.stdout, text)
    if "stubborn" in changes:
        device.camera.faults.keeps["ExposureTime"] = 5000
    over = threading.Event()
    if "free_running" in changes:
        threading.Thread(target=device.run_freely, args=(over,)).start()
    try:
        for line in sys.stdin:
            device.execute(line)
    finally:
        over.set()


if __name__ == "__main__":
    main(*sys.argv[1:])
