"""A camera in a process of its own, and a station's cameras over a real ring, for the tests in this folder."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.aravis.camera import AravisCamera, open_aravis_cameras
from vaoi_station.acquisition.cameras.aravis.library import aravis
from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraEvent, Slot
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.rig.network import addresses

PATIENCE_S = 20.0
WIDTH, HEIGHT = 96, 64

News = TypeVar("News")


class Device:
    """A camera in a process of its own."""

    def __init__(self, number: int, serial: str, changes: tuple[str, ...], film: Path) -> None:
        self.address, self.serial = addresses(number + 1)[number], serial
        self._changes, self._film = changes, film
        self.plug()

    def plug(self) -> None:
        program = str(Path(__file__).with_name("device.py"))
        self.process = subprocess.Popen(
            [sys.executable, program, self.address, self.serial, *self._changes],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.read_line() == f"ready {self.address}"
        if self._film.exists():
            self.order(f"film {self._film}")

    def order(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def read_line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def show(self, *pictures: NDArray[np.uint8]) -> None:
        """Load a film of these frames' bytes."""
        self._film.write_bytes(b"".join(p.tobytes() for p in pictures))
        self.order(f"film {self._film}")

    def fire(self, picture: int = -1, lost: float = 0.0, by_width: float | None = None) -> int:
        """Fire one trigger; return the id of the frame that was sent."""
        self.order(f"fire {picture} 0 1 {lost} {by_width}")
        sent, number, frame_id = self.read_line().split()
        assert (sent, int(number)) == ("sent", picture)
        return int(frame_id)

    def release(self) -> None:
        """Take control from the application that has it."""
        self.order("release")
        assert self.read_line() == "done"

    def second_client(self) -> Any:
        """Open the camera without control of it, to read its settings."""
        return aravis().Camera.new(self.address)

    def unplug(self) -> None:
        """Kill the process, as when the cable is pulled."""
        self.process.kill()
        self.process.communicate()


class Stage:
    """Opened cameras of a station, its ring, and what they announce."""

    def __init__(self, config: StationConfig) -> None:
        self.config = config
        self.cameras: tuple[AravisCamera, ...] = open_aravis_cameras(config)
        self.ring = Ring.create(ring_path(config), RingLayout.of(config))
        self.news: SimpleQueue[CameraEvent] = SimpleQueue()
        for camera in self.cameras:
            camera.start(self.news)

    def load(self, bay: int = 0) -> None:
        """Queue all slots of a bay, as before a run."""
        for number, camera in enumerate(self.cameras):
            for k in range(self.ring.layout.slots_per_camera):
                camera.queue(self.slot(self.ring.slot(bay, number, k)))

    def slot(self, number: int) -> Slot:
        return Slot(number, self.ring.memory(number))

    def counted(self, counter: str, number: int = 0) -> int:
        """Return a counter of a camera's driver."""
        return dict(self.cameras[number].health().counters)[counter]

    def wait(self, condition: Callable[[], bool]) -> None:
        """Wait until it holds, and drop events meanwhile; counters cause no event, so it is polled too."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, "the condition was not met in time"
            with contextlib.suppress(Empty):
                self.news.get(timeout=0.005)

    def arrival(self) -> Arrival:
        return self.until(Arrival)

    def until_back(self) -> int:
        """Wait until a camera is back and has its slots, which it gets after the event; return its number."""
        number = self.until(CameraBack).camera
        self.wait(lambda: self.cameras[number].health().connected)
        return number

    def until(self, kind: type[News]) -> News:
        """Return the next event of a kind; others are dropped."""
        deadline_s = time.monotonic() + PATIENCE_S
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                news = self.news.get(timeout=left_s)
            except Empty:
                break
            if isinstance(news, kind):
                return news
        raise AssertionError(f"no {kind.__name__} came")

    def close(self) -> None:
        """Close all cameras and the ring; may be called twice."""
        for camera in self.cameras:
            camera.close()
        self.ring.close()


def thread_names() -> list[str]:
    """Return the names of all threads of this process, with those of Aravis."""
    return [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]


def wait_for_remains() -> None:
    """Wait until lost cameras have been released; Aravis takes some seconds for each."""
    for thread in threading.enumerate():
        if thread.name.endswith("-remains"):
            thread.join(30)


def noise(seed: int, nbytes: int = WIDTH * HEIGHT) -> NDArray[np.uint8]:
    """Return the bytes of a frame that differs from all others."""
    return np.random.default_rng(seed).integers(0, 256, nbytes, dtype=np.uint8)
