"""The process of one virtual camera: start and stop it, send it triggers and receive its reports."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from vaoi_station.errors import DeviceError
from vaoi_station.rig.chip import raise_priority, stop_process

DARK = -1
"""Picture number of a black frame, which is in no file."""


@dataclass(frozen=True)
class TriggerCommand:
    """One rising edge of the trigger line, and the frame that the camera delivers for it."""

    picture: int
    """Index of the picture in the selected file of frames; DARK: a black frame."""
    timestamp_ns: int = 0
    """Start of the exposure, ns in the camera's clock; 0: use the time at which the frame is sent."""
    brightness: float = 1.0
    """Factor on the grey values above the black level."""
    lost_share: float = 0.0
    """Share of the frame's packets that are not sent, 0 to 1."""
    by_width: float | None = None
    """Brightness of a camera that exposes for as long as the trigger is high; None: the same in both modes."""

    def to_line(self) -> str:
        """Format the command as one line, without the line end."""
        # repr keeps all digits of a float, so that from_line returns an equal command.
        return f"fire {self.picture} {self.timestamp_ns} {self.brightness!r} {self.lost_share!r} {self.by_width!r}"

    @classmethod
    def from_line(cls, line: str) -> TriggerCommand:
        """Parse a line that `to_line` has written."""
        _, picture, timestamp, brightness, lost_share, by_width = line.split()
        width = None if by_width == "None" else float(by_width)
        return cls(int(picture), int(timestamp), float(brightness), float(lost_share), width)


READY_TIMEOUT_S = 30.0
"""Longest wait until a new camera process serves GVCP; on an idle computer it needs half a second."""
STOP_TIMEOUT_S = 10.0
ReportHandler = Callable[[str, int, int], None]
"""Function that receives a report: `sent` or `ignored`, the picture number and the frame id (0 means no frame)."""


class CameraProcess:
    """The process of one virtual camera, as a context manager. A thread passes its reports to a function."""

    def __init__(self, address: str, serial: str, on_report: ReportHandler = lambda _word, _picture, _id: None) -> None:
        self.address, self.serial = address, serial
        self._on_report = on_report
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._frames: Path | None = None
        self._sending = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Process id; None while the process does not run."""
        return self._process.pid if self._process is not None else None

    def start(self) -> None:
        """Start the process without waiting for it."""
        command = [sys.executable, "-m", "vaoi_station.rig.virtual_camera", self.address, self.serial]
        # In a separate session the camera does not get Ctrl-C: the rig stops its processes in order.
        # One OpenBLAS thread is enough: a camera computes no matrices, and twelve cameras share the cores.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1,
            start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        raise_priority(self._process.pid)
        self._ready: queue.SimpleQueue[bool] = queue.SimpleQueue()
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name=f"camera {self.address}")
        self._reader.start()
        # After a kill the new process must use the same file of frames as the old process.
        if self._frames is not None:
            self.select_frames(self._frames)

    def wait_ready(self) -> None:
        """Wait until the camera serves its address."""
        try:
            ready = self._ready.get(timeout=READY_TIMEOUT_S)
        except queue.Empty:
            ready = False
        if not ready:
            tail = self._stderr_tail()
            raise DeviceError(f"the virtual camera at {self.address} does not start. {tail}".strip())

    def select_frames(self, path: Path) -> None:
        """Select the file of frames from which the camera takes the pictures of the triggers that follow."""
        self._frames = path
        self._send(f"film {path}")

    def trigger(self, command: TriggerCommand, frames: Path | None = None) -> bool:
        """Trigger the camera once; return False if its process does not run."""
        if frames is None:
            return self._send(command.to_line())
        # The three lines are written together, so that a trigger of another thread does not use the file `frames`.
        return self._send(f"film {frames}", command.to_line(), *([f"film {self._frames}"] if self._frames else []))

    def kill(self) -> None:
        """Kill the process at once, which simulates a camera that loses its power."""
        if self._process is not None:
            self._process.kill()
            self._reap()

    def stop(self) -> None:
        """Close the camera's standard input and wait for the end of the process."""
        if self._process is not None:
            stop_process(self._process, STOP_TIMEOUT_S)
            self._reap()

    def __enter__(self) -> CameraProcess:
        self.start()
        try:
            self.wait_ready()
        except BaseException:  # on any failure, Ctrl-C included, no process may be left behind
            self.kill()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _send(self, *lines: str) -> bool:
        with self._sending:
            process = self._process
            if process is None or process.stdin is None:
                return False
            try:
                process.stdin.write("".join(f"{line}\n" for line in lines))
                process.stdin.flush()
            except (BrokenPipeError, ValueError):  # another thread has killed the process or closed the pipe
                return False
            return True

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                word, *rest = line.split()
                if word == "ready":
                    self._ready.put(True)
                else:
                    self._on_report(word, int(rest[0]), int(rest[1]) if len(rest) > 1 else 0)
        # End of file: if a process ends before it is ready, wait_ready must not wait for its full timeout.
        self._ready.put(False)

    def _stderr_tail(self) -> str:
        """Kill the process, and return the last lines of its standard error."""
        process = self._process
        if process is None or process.stderr is None:
            return ""
        # Reading the pipe to its end blocks as long as the process holds the other side open, so it is killed first.
        process.kill()
        process.wait()
        return process.stderr.read().strip()[-500:]

    def _reap(self) -> None:
        process, self._process = self._process, None
        assert process is not None
        process.wait()
        if self._reader is not None:
            self._reader.join()
        for pipe in (process.stdin, process.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
