"""The wires to one virtual camera: trigger orders go out, its words come back; it can be killed and put back."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO

from vaoi_station.errors import DeviceError
from vaoi_station.rig.devices.camera_orders import Order
from vaoi_station.rig.devices.processes import go_first, see_off

READY_S = 30.0
"""For a camera to serve GVCP; it takes half a second where nobody else wants the CPU."""
END_S = 10.0
Heard = Callable[[str, int, int], None]
"""`sent` or `ignored`, the picture, the frame id (0 if there is none)."""


class CameraWire:
    """One camera process; a context manager. What it says is passed on by a thread of its own."""

    def __init__(self, address: str, serial: str, heard: Heard = lambda _word, _picture, _id: None) -> None:
        self.address, self.serial = address, serial
        self._heard = heard
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._film: Path | None = None
        self._speaking = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Of the process; None while there is none."""
        return self._process.pid if self._process is not None else None

    def begin(self) -> None:
        """Start the process without waiting for it."""
        command = [sys.executable, "-m", "vaoi_station.rig.devices.virtual_camera", self.address, self.serial]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1,
            start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        go_first(self._process.pid)
        self._ready: queue.SimpleQueue[bool] = queue.SimpleQueue()
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name=f"wire {self.address}")
        self._reader.start()
        if self._film is not None:
            self.show(self._film)

    def wait(self) -> None:
        """Until it serves.

        Raises:
            DeviceError: it does not; the message has its own words.
        """
        try:
            served = self._ready.get(timeout=READY_S)
        except queue.Empty:
            served = False
        if not served:
            words = self._last_words()
            raise DeviceError(f"the virtual camera at {self.address} does not come up. {words}".strip())

    def show(self, film: Path) -> None:
        """Pictures of coming orders are from this file."""
        self._film = film
        self._say(f"film {film}")

    def fire(self, order: Order, film: Path | None = None) -> bool:
        """The trigger line rises; False if there is nobody at its end.

        Args:
            order: picture, time, light, loss.
            film: where this one picture is, if not in the film that is shown.
        """
        if film is None:
            return self._say(order.line())
        return self._say(f"film {film}", order.line(), *([f"film {self._film}"] if self._film else []))

    def kill(self) -> None:
        """Pull its plug."""
        if self._process is not None:
            self._process.kill()
            self._gone()

    def end(self) -> None:
        """Close its wires and wait for its end."""
        if self._process is not None:
            see_off(self._process, END_S)
            self._gone()

    def __enter__(self) -> CameraWire:
        self.begin()
        try:
            self.wait()
        except BaseException:  # whatever it was: no process is left behind
            self.kill()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def _say(self, *lines: str) -> bool:
        with self._speaking:
            process = self._process
            if process is None or process.stdin is None:
                return False
            try:
                process.stdin.write("".join(f"{line}\n" for line in lines))
                process.stdin.flush()
            except (BrokenPipeError, ValueError):  # killed meanwhile
                return False
            return True

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                word, *rest = line.split()
                if word == "ready":
                    self._ready.put(True)
                else:
                    self._heard(word, int(rest[0]), int(rest[1]) if len(rest) > 1 else 0)
        self._ready.put(False)

    def _last_words(self) -> str:
        process = self._process
        if process is None or process.stderr is None:
            return ""
        process.kill()
        process.wait()
        return process.stderr.read().strip()[-500:]

    def _gone(self) -> None:
        process, self._process = self._process, None
        assert process is not None
        process.wait()
        if self._reader is not None:
            self._reader.join()
        for pipe in (process.stdin, process.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
