"""Logging of all processes of the station: to systemd's journal with fields, or to standard output as text or JSON.

The journal's native protocol is one datagram per record (systemd.io/JOURNAL_NATIVE_PROTOCOL). With the fields beside
the message, a reader can select records: `journalctl VAOI_RUN=… VAOI_CAMERA=…`.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

TEXT = "%(levelname)s %(processName)s %(name)s: %(message)s"
JSON_VARIABLE = "VAOI_LOG_JSON"
"""Environment variable that selects JSON if it is not empty; child processes inherit it."""
SOCKET = "/run/systemd/journal/socket"
STREAM_VARIABLE = "JOURNAL_STREAM"
"""Environment variable with device and inode of the stream that systemd connected to the journal."""
FIELDS = ("run", "board", "camera", "event", "code")
"""Attributes of a log record, given as `extra`, that become fields of the journal and keys of JSON."""
LONGEST_BYTES = 48_000
"""Longest text of one field; a datagram must fit the socket's buffer."""
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
WINDOW_S = 60.0
SAME_TEXT, SAME_TEMPLATE = 5, 100
"""Largest numbers of records within `WINDOW_S` that are logged: of the same text, and of warnings that differ only in
their values."""
MOST_KEYS = 2000
"""Largest number of windows in memory; beyond it, the oldest windows are closed first."""


def configure_logging(as_json: bool | None = None) -> None:
    """Configure logging to standard output, as JSON or as text. None selects the format of the parent process.

    If standard output is systemd's journal, text is sent with fields, by the journal's own protocol; JSON is written as
    lines with the priority as a prefix.
    """
    if as_json is not None:
        os.environ[JSON_VARIABLE] = "1" if as_json else ""
    as_json, journal = bool(os.environ.get(JSON_VARIABLE)), is_journal(os.environ, 1)
    handler: logging.Handler
    if journal and not as_json:
        handler = JournalHandler()
    else:
        # Standard output and not a file, because systemd and containers collect and rotate it.
        handler = logging.StreamHandler(sys.stdout)
        formatter = JsonLines() if as_json else logging.Formatter(TEXT)
        handler.setFormatter(PriorityPrefix(formatter) if journal else formatter)
    handler.addFilter(RepeatLimit())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _priority(level: int) -> int:
    """Return the syslog priority for a logging level of Python: 2 critical, 3 error, 4 warning, 6 info, 7 debug."""
    return next((number for least, number in _PRIORITIES if level >= least), 7)


def is_journal(environment: Mapping[str, str], descriptor: int) -> bool:
    """Return whether a file descriptor is the stream that systemd connected to the journal."""
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    # Child processes inherit the variable even if their output goes elsewhere, so the numbers must be compared.
    return environment.get(STREAM_VARIABLE) == f"{status.st_dev}:{status.st_ino}"


def with_priority(text: str, level: int) -> str:
    """Return a text with the priority in front of every line, as sd-daemon(3) describes it: `<4>`."""
    return "\n".join(f"<{_priority(level)}>{line}" for line in text.splitlines())


def _fields_of(record: logging.LogRecord) -> dict[str, str]:
    return {name: str(value) for name in FIELDS if (value := getattr(record, name, None))}


class JsonLines(logging.Formatter):
    """Formatter that writes each log record as one JSON object on one line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as a JSON object: time, level, logger, process, message, fields and, if any, exception."""
        entry = {
            "time": self.formatTime(record, "%Y-%m-%dT%H:%M:%S") + f".{int(record.msecs):03d}",
            "level": record.levelname.lower(),
            "logger": record.name.removeprefix("vaoi_station."),
            "process": record.processName,
            "message": record.getMessage(),
            **_fields_of(record),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


class PriorityPrefix(logging.Formatter):
    """Formatter that puts the priority in front of every line of another one."""

    def __init__(self, inner: logging.Formatter) -> None:
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of the inner formatter, each with the prefix."""
        return with_priority(self._inner.format(record), record.levelno)


class JournalHandler(logging.Handler):
    """Handler that sends each record to the journal with its fields. If this fails, it writes a line to stdout."""

    def __init__(self, path: str = SOCKET) -> None:
        super().__init__()
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        # A journal that does not read must not stop the station: after this time, the line goes to stdout.
        self._socket.settimeout(1.0)
        self._otherwise = logging.StreamHandler(sys.stdout)
        self._otherwise.setFormatter(PriorityPrefix(logging.Formatter(TEXT)))

    def emit(self, record: logging.LogRecord) -> None:
        """Send one log record to the journal."""
        message = record.getMessage()
        if record.exc_info:
            message += "\n" + logging.Formatter().formatException(record.exc_info)
        fields = {
            "MESSAGE": message,
            "PRIORITY": str(_priority(record.levelno)),
            "SYSLOG_IDENTIFIER": "vaoi",
            "VAOI_PROCESS": str(record.processName),
            "VAOI_LOGGER": record.name.removeprefix("vaoi_station."),
            "CODE_FILE": record.pathname,
            "CODE_LINE": str(record.lineno),
            **{f"VAOI_{name.upper()}": value for name, value in _fields_of(record).items()},
        }
        try:
            self._socket.sendto(b"".join(_journal_field(name, value) for name, value in fields.items()), self._path)
        except OSError:
            self._otherwise.handle(record)

    def close(self) -> None:
        """Close the socket to the journal."""
        self._socket.close()
        super().close()


def _journal_field(name: str, value: str) -> bytes:
    data = value.encode("utf-8", "replace")[:LONGEST_BYTES]
    if b"\n" not in data:
        return b"%s=%s\n" % (name.encode(), data)
    # In front of a value with line breaks stands its length: 64 bits, least significant byte first.
    return b"%s\n%s%s\n" % (name.encode(), len(data).to_bytes(8, "little"), data)


@dataclass
class _Window:
    since_s: float
    count: int = 0
    dropped: int = 0


class RepeatLimit(logging.Filter):
    """Filter that drops records that are logged too often, so that one fault cannot fill the log and hide the others.

    The first record after a window states how many it dropped.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock, self._lock = clock, threading.Lock()
        # Two tables, so that many different texts do not close the window of their common template.
        self._texts: dict[tuple[str, int, str], _Window] = {}
        self._templates: dict[tuple[str, int, str], _Window] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return False for a record over a limit."""
        with self._lock:
            dropped, is_open = self._count(self._texts, record, record.getMessage(), SAME_TEXT)
            if record.levelno >= logging.WARNING:
                more, also = self._count(self._templates, record, str(record.msg), SAME_TEMPLATE)
                # The same record must not be counted as dropped for both reasons.
                dropped, is_open = max(dropped, more), is_open and also
        if is_open and dropped:
            record.msg = f"{record.getMessage()} [{dropped} more in {WINDOW_S:.0f} s were not logged]"
            record.args = None
        return is_open

    def _count(
        self, windows: dict[tuple[str, int, str], _Window], record: logging.LogRecord, text: str, limit: int
    ) -> tuple[int, bool]:
        """Count a record; return how many the window before dropped, and whether this one is within the limit."""
        key, now_s, dropped = (record.name, record.levelno, text), self._clock(), 0
        window = windows.get(key)
        if window is None or now_s - window.since_s >= WINDOW_S:
            dropped = window.dropped if window else 0
            windows.pop(key, None)  # A new entry goes to the end, because entries are ordered by age.
            if len(windows) >= MOST_KEYS:
                del windows[next(iter(windows))]
            window = windows[key] = _Window(now_s)
        window.count += 1
        window.dropped += window.count > limit
        return dropped, window.count <= limit
