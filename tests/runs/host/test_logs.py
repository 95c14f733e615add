"""Log records as text, as JSON and for systemd's journal, and the limit of repeated ones."""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.runs.host.logs import (
    JSON_VARIABLE,
    SAME_TEMPLATE,
    SAME_TEXT,
    STREAM_VARIABLE,
    WINDOW_S,
    JournalHandler,
    JsonLines,
    RepeatLimit,
    configure_logging,
    is_journal,
)


def test_a_record_is_one_json_object() -> None:
    try:
        raise ValueError("no\nsuch thing")
    except ValueError:
        record = logging.LogRecord(
            "vaoi_station.runs.control.core",
            logging.WARNING,
            __file__,
            1,
            "run %s: %s",
            ("r1", "größer"),
            sys.exc_info(),
        )
    line = JsonLines().format(record)
    assert "\n" not in line
    entry = json.loads(line)
    assert (entry["level"], entry["logger"], entry["message"]) == ("warning", "runs.control.core", "run r1: größer")
    assert "ValueError" in entry["exception"]


@pytest.fixture
def root() -> Iterator[logging.Logger]:
    """The root logger without handlers; its own are restored afterwards."""
    logger = logging.getLogger()
    before, level = logger.handlers[:], logger.level
    logger.handlers = []
    yield logger
    logger.handlers = before
    logger.setLevel(level)


@pytest.mark.parametrize("as_json", [True, False])
def test_the_format_is_inherited_by_child_processes(
    root: logging.Logger, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    monkeypatch.setenv(JSON_VARIABLE, "")
    configure_logging(as_json)
    inherited = os.environ[JSON_VARIABLE]
    root.handlers = []
    configure_logging()
    (handler,) = root.handlers
    assert isinstance(handler.formatter, JsonLines) is as_json
    assert bool(inherited) is as_json


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
    handler = JournalHandler(str(path))
    handler.handle(record("camera left: no frames\nsecond = line", run="r1", board="B7", camera="left", code=""))
    fields = parsed(received.recv(1 << 16))
    handler.close()
    assert fields["MESSAGE"] == "camera left: no frames\nsecond = line"
    assert (fields["PRIORITY"], fields["SYSLOG_IDENTIFIER"], fields["VAOI_LOGGER"]) == ("4", "vaoi", "runs.x")
    assert (fields["VAOI_RUN"], fields["VAOI_BOARD"], fields["VAOI_CAMERA"]) == ("r1", "B7", "left")
    assert "VAOI_CODE" not in fields


def test_without_a_journal_the_line_goes_to_stdout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    handler = JournalHandler(str(tmp_path / "none"))
    handler.handle(record("one\ntwo", logging.ERROR))
    handler.close()
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("<3>ERROR")
    assert second == "<3>two"


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


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def logged(limit: RepeatLimit, template: str, *values: object, level: int = logging.ERROR) -> str | None:
    record = logging.LogRecord("x", level, __file__, 1, template, values, None)
    return record.getMessage() if limit.filter(record) else None


def test_the_same_text_is_logged_a_few_times_and_then_counted() -> None:
    clock = Clock()
    limit = RepeatLimit(clock)
    seen = [logged(limit, "too many open files") for _ in range(1000)]
    assert [text for text in seen if text] == ["too many open files"] * SAME_TEXT
    assert logged(limit, "another") == "another"
    clock.now_s = WINDOW_S + 1
    text = logged(limit, "too many open files")
    assert text is not None
    assert f"{1000 - SAME_TEXT} more" in text
    assert logged(limit, "too many open files") == "too many open files"


def test_warnings_that_differ_in_values_only_are_limited_too() -> None:
    limit = RepeatLimit(Clock())
    seen = [logged(limit, "caller %s does not read", n) for n in range(5000)]
    assert len([text for text in seen if text]) == SAME_TEMPLATE
