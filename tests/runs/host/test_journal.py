"""Records for systemd's journal, received from a real datagram socket."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.runs.host.journal import STREAM_VARIABLE, JournalHandler, PriorityPrefix, is_journal, priority

Receiver = tuple[socket.socket, Path]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Receiver]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as received:
        path = tmp_path / "socket"
        received.bind(str(path))
        received.settimeout(10)
        yield received, path


def record(message: str, level: int = logging.WARNING, **fields: str) -> logging.LogRecord:
    made = logging.LogRecord("vaoi_station.runs.x", level, __file__, 7, "%s", (message,), None)
    made.__dict__.update(fields)
    return made


def parsed(datagram: bytes) -> dict[str, str]:
    """Read the journal's native protocol."""
    fields, rest = {}, datagram
    while rest:
        line, _, rest = rest.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            size, rest = int.from_bytes(rest[:8], "little"), rest[8:]
            value, rest = rest[:size], rest[size + 1 :]
        fields[name.decode()] = value.decode()
    return fields


def test_record_has_priority_and_fields(journal: Receiver) -> None:
    received, path = journal
    handler = JournalHandler("vaoi", str(path))
    handler.handle(record("camera left: no frames\nsecond = line", run="r1", board="B7", camera="left", code=""))
    fields = parsed(received.recv(1 << 16))
    handler.close()
    assert fields["MESSAGE"] == "camera left: no frames\nsecond = line"
    assert (fields["PRIORITY"], fields["SYSLOG_IDENTIFIER"], fields["VAOI_LOGGER"]) == ("4", "vaoi", "runs.x")
    assert (fields["VAOI_RUN"], fields["VAOI_BOARD"], fields["VAOI_CAMERA"]) == ("r1", "B7", "left")
    assert "VAOI_CODE" not in fields


def test_without_a_journal_the_line_goes_to_stdout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    handler = JournalHandler("vaoi", str(tmp_path / "none"))
    handler.handle(record("one\ntwo", logging.ERROR))
    handler.close()
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("<3>ERROR")
    assert second == "<3>two"


@pytest.mark.parametrize(
    ("level", "expected"),
    [(logging.DEBUG, 7), (logging.INFO, 6), (logging.WARNING, 4), (logging.ERROR, 3), (logging.CRITICAL, 2)],
)
def test_priorities_are_those_of_syslog(level: int, expected: int) -> None:
    assert priority(level) == expected
    assert PriorityPrefix(logging.Formatter()).format(record("x", level)) == f"<{expected}>x"


def test_only_the_journals_own_stream_counts(tmp_path: Path) -> None:
    with (tmp_path / "out").open("w") as out:
        found = os.fstat(out.fileno())
        environment = {STREAM_VARIABLE: f"{found.st_dev}:{found.st_ino}"}
        assert is_journal(environment, out.fileno())
        assert not is_journal({}, out.fileno())
        assert not is_journal({STREAM_VARIABLE: "1:2"}, out.fileno())
    assert not is_journal(environment, 10_000)


LOGS = """
import logging, os, sys
found = os.fstat(1)
os.environ["JOURNAL_STREAM"] = f"{found.st_dev}:{found.st_ino}"
from vaoi_station.runs.host.logs import configure_logging
configure_logging(as_json=True)
logging.getLogger("a").warning("w", extra={"run": "r1"})
"""


def test_json_for_the_journal_has_the_prefix() -> None:
    done = subprocess.run([sys.executable, "-c", LOGS], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.startswith('<4>{"')
    assert '"run": "r1"' in done.stdout
