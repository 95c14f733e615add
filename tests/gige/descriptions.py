"""Opens, sets up and films with a camera of every description of a folder, and prints docs/reference/camera-models.md.

    python -m tests.gige.descriptions FOLDER [PATTERN]

FOLDER has GenICam descriptions (.xml or .xml.gz), as areaDetector/ADGenICam collects them. Each camera starts with
something left over in every feature that changes pictures or times, is set up without its user set, and films a board
at its own geometry, or at a part of it that two cores can carry. The reference implementation of GenApi reads what the
station has written. The program needs a network of its own, which it makes.
"""

from __future__ import annotations

import gzip
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.conftest import Bench
from tests.gige.leftovers import leave_all, survivors
from tests.gige.line import ScriptedController
from tests.gige.referee import Referee
from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import Arm, Armed, Ready, RunFinished
from vaoi_station.config import CameraConfig
from vaoi_station.errors import VaoiError
from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.description import Description, DescriptionError
from vaoi_station.rig.gige.first_values import Sensor
from vaoi_station.rig.network import NAMESPACE_VARIABLE, LoopbackAddresses, addresses, isolation_command

PERIOD_S, START_S, ROWS = 0.2, 0.5, 3
EXPOSURE_US = 250.0
LARGEST_PX = (2448, 2048)
"""The part of a larger sensor that is filmed: two cores that send and receive carry no more per pulse."""
SENSORS = {
    "AVT_GC1380H": (1360, 1024), "AVT_GT2450CB": (2448, 2048), "AVT_Mako_G234B": (1936, 1216),
    "AVT_Manta_G507B": (2464, 2056), "Allied_Vision_1800_U-811m": (2848, 2848), "Basler-a2A2600-20gmBAS": (2592, 2128),
    "Basler-acA1300-60gm": (1280, 1024), "Basler-acA2440-20gm": (2448, 2048), "Basler-scA1400-30gm": (1392, 1040),
    "FLIR-BFS-PGE-50S4C": (2448, 2048), "FLIR_BFLY_PGE_13H2M": (1288, 964), "FLIR_FL3_U3_13S2C": (1328, 1048),
    "FLIR_ORX_10G_245S8M": (5320, 4600), "PGR_BFS_U3_51S5M": (2448, 2048), "PGR_Flea3_GE_28S4C": (1928, 1448),
    "PGR_GS3_U3_51S5M": (2448, 2048), "ViewWorks_VNP604": (14192, 10640),
}  # fmt: skip
"""Width and height of the sensors whose descriptions leave them to the camera, by the models' names."""
USUAL_PX = (1936, 1216)


HEAD = """<!-- Written by `python -m tests.gige.descriptions FOLDER`: change its source, not this page. -->

# Camera models that were set up

Each description (GenICam XML) is served over loopback by an emulated camera, also those of USB3 cameras. Before, every
feature that changes pictures or times had a value left over. A model *films* if all of these are neutral and three rows
are proven and equal to what was sent. The table is about names, kinds, units, selectors and locks, not about how a
camera behaves. Another model: [cameras](cameras.md), then `vaoi doctor`.

Trigger, exposure and gain are as the reference implementation of GenApi reads them; 250 µs and 0 dB were wanted. A
sensor whose description leaves its size to the camera has 1936 × 1216 px. Descriptions: areaDetector/ADGenICam,
areaDetector/aravisGigE, jfrazao/GenICam, Touseefelahi/GigeVision, dls-controls/ADGenICam.
"""


class Row(NamedTuple):
    """A line of the table."""

    description: str
    films: str
    trigger: str = ""
    exposure: str = ""
    gain: str = ""
    clock: str = ""
    picture: str = ""


class FilmingLine:
    """The acquisition process of a station with these cameras, and a controller that a test drives."""

    def __init__(self, folder: Path, cameras: Sequence[Camera], configured: Sequence[CameraConfig]) -> None:
        self.cameras, self.controller = cameras, ScriptedController()
        config = station_config(folder, list(configured), PERIOD_S)
        began_s = time.monotonic()
        opened = open_aravis_cameras(config)  # here, as a refusal would end the acquisition process
        self.opening_s = time.monotonic() - began_s
        self.bench = Bench(config, lambda _: Devices(opened, self.controller))
        self.bench.until(Ready)
        self._pace = threading.Event()

    def film(self, rows: int = ROWS, after: Callable[[int], object] = lambda _row: None) -> RunFinished:
        """Film a board; every camera exposes noise of its own in every row, and what arrived is compared with it.

        `after` is called after each row; row −1 is the time from the barrier to the first pulse.
        """
        self.bench.grant("run 0", 0)
        self.bench.send(Arm(replace(TriggerPlan.of(self.bench.config.line), start_delay_s=START_S)))
        self.bench.until(Armed)

        def expose(row: int, edge_ns: int) -> None:
            if row >= 0:
                for number, camera in enumerate(self.cameras):
                    camera.expose(self.picture(number, row), edge_ns=edge_ns)
            self._pace.wait(PERIOD_S if row >= 0 else START_S)
            after(row)

        self.controller.board(rows, expose)
        return self.bench.until(RunFinished)

    def picture(self, number: int, row: int) -> bytes:
        """Return the bytes of a frame."""
        size = self.cameras[number].payload_bytes
        block = np.random.default_rng((number, row)).integers(0, 256, 4096, dtype=np.uint8).tobytes()
        return (block * (size // 4096 + 1))[:size]

    def proven(self, done: RunFinished) -> int:
        """Return how many frames are usable, proven, and equal to what was sent."""
        return sum(
            frame.usable and frame.slot is not None
            and self.bench.ring.memory(frame.slot).tobytes() == self.picture(frame.camera, frame.row)
            for frame in done.frames
        ) if done.proof is not None and done.proof.proven else 0  # fmt: skip

    def close(self) -> None:
        """Close the cameras and the ring."""
        self.bench.close()


def read(path: Path) -> str:
    """Return the text of a description."""
    content = path.read_bytes()
    return (gzip.decompress(content) if path.suffix == ".gz" else content).decode("utf-8-sig", "replace")


def sensor_of(name: str, text: str) -> Sensor:
    """Return the size of a camera's sensor: that of its description, else that of its model."""
    stated = Description(text)
    sizes = []
    for feature, usual in zip(("SensorWidth", "SensorHeight"), SENSORS.get(name, USUAL_PX), strict=True):
        constant = stated.text_of(feature, "Value") if feature in stated.nodes else None
        sizes.append(int(constant, 0) if constant and name not in SENSORS else usual)
    return Sensor(*sizes)


def judge(name: str, text: str, folder: Path) -> Row:
    """Open a camera with this description, and return its line."""
    try:
        sensor = sensor_of(name, text)
        camera = Camera("127.0.0.2", text, serial="TABLE", sensor=sensor)
    except (DescriptionError, KeyError, ValueError) as error:
        return Row(name, f"no: the stand-in: {error!r}"[:120])
    try:
        steps = [max(16, int(camera.features.limits(name)[2])) for name in ("Width", "Height")]
        whole = [size // step * step for size, step in zip((sensor.width_px, sensor.height_px), steps, strict=True)]
        size = [min(a, most // step * step) for a, most, step in zip(whole, LARGEST_PX, steps, strict=True)]
        formats = camera.entries("PixelFormat")
        pixel_format = next(
            (f for f in ("Mono8", "BayerRG8", "BayerGB8", "BayerGR8", "BayerBG8") if f in formats), "Mono8"
        )
        config = camera_config(
            name="c0", address=camera.address, width=size[0], height=size[1], pixel_format=pixel_format,
            exposure_us=EXPOSURE_US, user_set="keep",
        )  # fmt: skip
        left = leave_all(camera)
        line = FilmingLine(folder, [camera], [config])
    except (VaoiError, AssertionError, LookupError, ValueError) as error:
        camera.close()
        return Row(name, "no: " + str(error).replace("\n", " ").replace("camera c0: ", "").split(". ")[0][:120])
    try:
        alive = list(survivors(camera, left))
        referee = Referee(camera)
        done = line.film()
        usable, proof = line.proven(done), done.proof
        part = "" if size == whole else " (a part)"
        why = next((frame.cause for frame in done.frames if not frame.usable), "") or (
            "; ".join(str(found) for found in proof.findings) if proof else ""
        )
        wrong = "; ".join(alive) if alive else "" if usable == ROWS else f"{usable} of {ROWS} frames: {why}"
        return Row(
            name,
            f"no: {wrong}"[:120] if wrong else "yes",
            f"{camera.frame_trigger or 'the only one'}, {camera.trigger()}",
            _stated(referee, ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")),
            _stated(referee, ("Gain", "GainAbs", "GainRaw")),
            f"{camera.tick_hz / 1e6:g} MHz",
            f"{size[0]} × {size[1]} {pixel_format}{part}",
        )
    finally:
        line.close()
        camera.close()


def _stated(referee: Referee, names: Sequence[str]) -> str:
    name = next((n for n in names if referee.has(n)), None)
    return "none" if name is None else f"{name} {referee.value(name):g}"


def main(folder: str, pattern: str = "*") -> None:
    """Print the page."""
    print(HEAD)
    print("| " + " | ".join(Row._fields) + " |")
    print("|" + "---|" * len(Row._fields))
    for path in sorted([*Path(folder).glob(f"{pattern}.xml"), *Path(folder).glob(f"{pattern}.xml.gz")]):
        name = path.name.removesuffix(".gz").removesuffix(".xml")
        with tempfile.TemporaryDirectory() as place:
            row = judge(name, read(path), Path(place))
        print("| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |", flush=True)


if __name__ == "__main__":
    if not os.environ.get(NAMESPACE_VARIABLE):
        command = [*isolation_command(), sys.executable, "-m", "tests.gige.descriptions", *sys.argv[1:]]
        os.execvpe(command[0], command, os.environ | {NAMESPACE_VARIABLE: "1"})
    with LoopbackAddresses(addresses(1)):
        main(*sys.argv[1:])
