"""The process of an emulated device: it takes commands as lines of text, and reports in lines as well."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import IO, Self

from vaoi_station.errors import DeviceError

DEVICE_NICENESS = -10
"""Niceness (scheduling priority) of device processes. Only root may set a value below 0."""
READY_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0


class DeviceProcess(ABC):
    """A process as a context manager; a thread passes what it reports to `on_report`."""

    def __init__(self, name: str, command: Sequence[str]) -> None:
        """Prepare the process; `name` is used in messages."""
        self._name, self._command = name, list(command)
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._ready: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._sending = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Process id; None while the process does not run."""
        return self._process.pid if self._process is not None else None

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    @abstractmethod
    def on_report(self, word: str, rest: list[str]) -> bool:
        """Handle one line, split into its words; return whether it shows that the device is ready."""

    def start(self) -> None:
        """Start the process without waiting for it."""
        # In a separate session it does not get Ctrl-C: the rig stops its processes in order. One OpenBLAS thread is
        # enough: a device computes no matrices, and twelve cameras share the cores.
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1,
            start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        raise_priority(self._process.pid)
        self._ready = queue.SimpleQueue()
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name=self._name)
        self._reader.start()

    def wait_ready(self) -> None:
        """Wait until the device is ready; raise DeviceError with the last words of the process if it does not start."""
        try:
            ready = self._ready.get(timeout=READY_TIMEOUT_S)
        except queue.Empty:
            ready = False
        if not ready:
            raise DeviceError(f"{self._name} does not start. {self._last_words()}".strip())

    def write(self, *lines: str) -> bool:
        """Send lines together; return False if the process does not run."""
        with self._sending:
            if self._process is None or self._process.stdin is None:
                return False
            try:
                self._process.stdin.write("".join(f"{line}\n" for line in lines))
                self._process.stdin.flush()
            except (BrokenPipeError, ValueError):  # another thread has killed the process or closed the pipe
                return False
            return True

    def kill(self) -> None:
        """Kill the process at once, which simulates a device that loses its power."""
        if self._process is not None:
            self._process.kill()
            self._reap()

    def stop(self) -> None:
        """Close the standard input of the process and wait for its end; kill it after a timeout."""
        if self._process is not None:
            stop_process(self._process, STOP_TIMEOUT_S)
            self._reap()

    def __enter__(self) -> Self:
        self.start()
        try:
            self.wait_ready()
        except BaseException:  # on any failure, Ctrl-C included, no process may be left behind
            self.kill()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                word, *rest = line.split()
                if self.on_report(word, rest):
                    self._ready.put(True)
        # End of file: if a process ends before it is ready, wait_ready must not wait for its full timeout.
        self._ready.put(False)

    def _last_words(self) -> str:
        """Kill the process, and return the end of its standard error."""
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


def raise_priority(pid: int) -> None:
    """Give a process priority over the station's processes. Without the right to do so, change nothing."""
    # Real devices do not wait for the station's CPU. So emulated devices should wait as little as possible.
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, DEVICE_NICENESS)


def stop_process(process: subprocess.Popen[str], timeout_s: float) -> None:
    """Close the standard input of a process and wait for its end. Kill the process after the timeout."""
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # the process has ended by itself
        process.stdin.close()
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
