"""The service in a process of its own: started, found by the address it tells, ended in order."""

from __future__ import annotations

import os
import queue
import re
import signal
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path
from typing import IO

from vaoi_station.errors import DeviceError, InternalError

START_S = 60.0
"""Until it listens, on a busy machine."""
END_S = 30.0
"""A service that has not ended in order by then is killed; its children end with it."""
_LOG_LINES = 200
_LISTENING = re.compile(r"listening on (http://\S+)")


class Service:
    """A context manager; `address` and `pid` are there inside it.

    Attributes:
        address: `http://HOST:PORT` where it listens.
    """

    def __init__(self, config: Path, port: int = 0) -> None:
        """`config` is a station.toml; port 0: any that is free."""
        self._command = [sys.executable, "-m", "vaoi_station.demo.service_process", str(config), str(port)]
        self._log: deque[str] = deque(maxlen=_LOG_LINES)
        self._found: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self.address = ""

    @property
    def pid(self) -> int:
        """Of the station process; its children are listed by `GET station`."""
        assert self._process is not None
        return self._process.pid

    @property
    def log(self) -> str:
        """The last lines it wrote."""
        return "".join(self._log)

    def __enter__(self) -> Service:
        try:
            self._start()
        except BaseException:  # whatever it was, also Ctrl-C: no process is left behind
            self._end()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        code = self._end()
        if code and kind is None:
            raise InternalError(f"the service ended with code {code}; its last words: {self._last_words()}")

    def _start(self) -> None:
        """A session of its own, so that Ctrl-C at the terminal reaches only us, and it ends when we say so."""
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name="service log")
        self._reader.start()
        try:
            address = self._found.get(timeout=START_S)
        except queue.Empty:
            raise DeviceError(f"the service does not listen after {START_S:.0f} s: {self._last_words()}") from None
        if address is None:
            raise DeviceError(f"the service did not start: {self._last_words()}")
        self.address = address

    def _read(self, lines: IO[str]) -> None:
        """Keep its pipe empty to the end."""
        with lines:
            for line in lines:
                self._log.append(line)
                if found := _LISTENING.search(line):
                    self._found.put(found[1])
        self._found.put(None)

    def _end(self) -> int:
        """Ask it to end, wait, and only then make it."""
        process = self._process
        if process is None:
            return 0
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdin is not None:
            process.stdin.close()
        if self._reader is not None:
            self._reader.join()
        return process.returncode

    def _last_words(self) -> str:
        return (list(self._log) or ["it said nothing"])[-1].strip()
