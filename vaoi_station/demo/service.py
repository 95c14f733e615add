"""Run the service in a separate process: start it, read the service's address from its log, and end it.

This module imports little, so that the process can be started before anything else.
"""

from __future__ import annotations

import queue
import re
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from vaoi_station.child_environment import child_environment
from vaoi_station.errors import DeviceError, InternalError

START_S = 180.0
"""Longest time until the service listens, also on a busy machine."""
END_S = 30.0
"""Longest time, s, for the service to end after SIGTERM; after it, the service is killed with its child processes."""
_LOG_LINES = 200
_LISTENING = re.compile(r"listening on (http://\S+)")


class Service:
    """Context manager of a service process; `address` and `pid` are valid inside the block.

    Attributes:
        config: path of its station.toml.
        port: port where it is to listen, 0 for any free one.
        address: `http://HOST:PORT` where it listens.
    """

    def __init__(self, config: Path, port: int = 0) -> None:
        """Prepare the service of the station.toml at `config`. Port 0 selects any free port."""
        self.config, self.port = config, port
        self._command = [sys.executable, "-P", "-m", "vaoi_station.demo.service_process", str(config), str(port)]
        self._log: deque[str] = deque(maxlen=_LOG_LINES)
        self._found: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self.address = ""
        self._ending = False

    @property
    def pid(self) -> int:
        """Process id of the station; `GET station` lists its child processes."""
        assert self._process is not None
        return self._process.pid

    @property
    def log(self) -> str:
        """The last lines of the log that the service wrote."""
        return "".join(self._log)

    @contextmanager
    def importing(self) -> Iterator[Service]:
        """Start the process, which imports meanwhile. Its station.toml must be there before its own block begins."""
        try:
            self._launch()
            yield self
        finally:
            self._end()

    def __enter__(self) -> Service:
        try:
            self._start()
        except BaseException:  # also on Ctrl-C: no process may stay behind
            self._end()
            raise
        return self

    def request_end(self) -> None:
        """Send SIGTERM without waiting: the service ends while the caller goes on, and the block waits for its end."""
        assert self._process is not None
        if not self._ending:
            self._ending = True
            self._process.send_signal(signal.SIGTERM)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        code = self._end()
        if code and kind is None:
            raise InternalError(f"the service ended with code {code}; its last log line: {self._last_line()}")

    def _launch(self) -> None:
        """Start the process, which waits for `_start` before it reads its configuration."""
        # The service gets a separate session: Ctrl-C at the terminal then reaches this process only, which ends it.
        # Its output is not buffered, because the line with the address must arrive at once, not when a block is full.
        environment = child_environment(PYTHONUNBUFFERED="1")
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

    def _start(self) -> None:
        """Start the process if it was not started, and wait until it listens."""
        if self._process is None:
            self._launch()
        assert self._process is not None, "it was launched"
        assert self._process.stdin is not None, "it is a pipe"
        with suppress(BrokenPipeError):  # it has ended, which the end of its log shows
            self._process.stdin.write("\n")
            self._process.stdin.flush()
        try:
            address = self._found.get(timeout=START_S)
        except queue.Empty:
            raise DeviceError(
                f"the service does not listen after {START_S:.0f} s; its last log line: {self._last_line()}"
            ) from None
        if address is None:
            raise DeviceError(f"the service did not start; its last log line: {self._last_line()}")
        self.address = address

    def _read(self, lines: IO[str]) -> None:
        """Read the service's log until it ends. Otherwise the pipe would become full and block the service."""
        with lines:
            for line in lines:
                self._log.append(line)
                if found := _LISTENING.search(line):
                    self._found.put(found[1])
        self._found.put(None)

    def _end(self) -> int:
        """Send SIGTERM, wait, and kill the process only if it does not end in time; return its exit code."""
        process = self._process
        if process is None:
            return 0
        self.request_end()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdin is not None:
            with suppress(BrokenPipeError):
                process.stdin.close()
        if self._reader is not None:
            self._reader.join()
        return process.returncode

    def _last_line(self) -> str:
        return (list(self._log) or ["none"])[-1].strip()


def refuse_taken_port(port: int) -> None:
    """Raise DeviceError if another program listens at a port of the demo's service. Port 0 is always free."""
    if port == 0:
        return
    # Checked here before the board is drawn, which takes seconds; the service itself refuses a port taken meanwhile.
    # Imported here: the package of the web server imports the whole station, which only the service's process needs.
    from vaoi_station.api.web_server import open_listener
    from vaoi_station.config import ApiConfig

    host = ApiConfig().host
    try:
        open_listener(host, port, "vaoi demo").close()
    except DeviceError as error:
        raise DeviceError(
            f"{error.message} Another station or demo may run there: http://{host}:{port}/.",
            action="End that program, or choose another port: --port 8351, or --port 0 for any free one.",
        ) from error
