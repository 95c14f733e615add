"""Log records as text, as JSON and for systemd's journal, and the limit of repeated ones."""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.runs.host.logs import (
    JSON_VARIABLE,
    SAME_TEXT,
    WINDOW_S,
    JsonLines,
    RepeatLimit,
    configure_logging,
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
