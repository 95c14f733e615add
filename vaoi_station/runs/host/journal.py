"""Log records for systemd's journal: its native protocol with fields, or lines with the priority as a prefix.

The protocol is one datagram per record (systemd.io/JOURNAL_NATIVE_PROTOCOL). With the fields beside the message, a
reader can select records: `journalctl VAOI_RUN=… VAOI_CAMERA=…`.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Mapping

SOCKET = "/run/systemd/journal/socket"
STREAM_VARIABLE = "JOURNAL_STREAM"
"""Environment variable with device and inode of the stream that systemd connected to the journal."""
FIELDS = ("run", "board", "camera", "event", "code")
"""Attributes of a log record, given as `extra`, that become fields of the journal and keys of JSON."""
LONGEST_BYTES = 48_000
"""Longest text of one field; a datagram must fit the socket's buffer."""
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))


def priority(level: int) -> int:
    """Return the syslog priority for a logging level of Python: 2 critical, 3 error, 4 warning, 6 info, 7 debug."""
    return next((number for least, number in _PRIORITIES if level >= least), 7)


def is_journal(environment: Mapping[str, str], descriptor: int) -> bool:
    """Return whether a file descriptor is the stream that systemd connected to the journal."""
    try:
        found = os.fstat(descriptor)
    except OSError:
        return False
    # Child processes inherit the variable even if their output goes elsewhere, so the numbers must be compared.
    return environment.get(STREAM_VARIABLE) == f"{found.st_dev}:{found.st_ino}"


def with_priority(text: str, level: int) -> str:
    """Return a text with the priority in front of every line, as sd-daemon(3) describes it: `<4>`."""
    return "\n".join(f"<{priority(level)}>{line}" for line in text.splitlines())


def fields_of(record: logging.LogRecord) -> dict[str, str]:
    """Return those of `FIELDS` that a log record has and that are not empty."""
    return {name: str(value) for name in FIELDS if (value := getattr(record, name, None))}


class PriorityPrefix(logging.Formatter):
    """Formatter that puts the priority in front of every line."""

    def __init__(self, inner: logging.Formatter) -> None:
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of the inner formatter, each with the prefix."""
        return with_priority(self._inner.format(record), record.levelno)


class JournalHandler(logging.Handler):
    """Handler that sends each record to the journal with its fields. If this fails, it writes a line to stdout."""

    def __init__(self, identifier: str, path: str = SOCKET) -> None:
        super().__init__()
        self._identifier, self._path = identifier, path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        # A journal that does not read must not stop the station: after this time, the line goes to stdout.
        self._socket.settimeout(1.0)
        self._otherwise = logging.StreamHandler(sys.stdout)
        self._otherwise.setFormatter(
            PriorityPrefix(logging.Formatter("%(levelname)s %(processName)s %(name)s: %(message)s"))
        )

    def emit(self, record: logging.LogRecord) -> None:
        """Send one log record to the journal."""
        try:
            self._socket.sendto(self.datagram(record), self._path)
        except OSError:
            self._otherwise.handle(record)

    def datagram(self, record: logging.LogRecord) -> bytes:
        """Return the record in the journal's native protocol."""
        message = record.getMessage()
        if record.exc_info:
            message += "\n" + logging.Formatter().formatException(record.exc_info)
        fields = {
            "MESSAGE": message,
            "PRIORITY": str(priority(record.levelno)),
            "SYSLOG_IDENTIFIER": self._identifier,
            "VAOI_PROCESS": str(record.processName),
            "VAOI_LOGGER": record.name.removeprefix("vaoi_station."),
            "CODE_FILE": record.pathname,
            "CODE_LINE": str(record.lineno),
        }
        fields |= {f"VAOI_{name.upper()}": value for name, value in fields_of(record).items()}
        return b"".join(_field(name, value) for name, value in fields.items())

    def close(self) -> None:
        """Close the socket to the journal."""
        self._socket.close()
        super().close()


def _field(name: str, value: str) -> bytes:
    data = value.encode("utf-8", "replace")[:LONGEST_BYTES]
    if b"\n" not in data:
        return b"%s=%s\n" % (name.encode(), data)
    # In front of a value with line breaks stands its length: 64 bits, least significant byte first.
    return b"%s\n%s%s\n" % (name.encode(), len(data).to_bytes(8, "little"), data)
