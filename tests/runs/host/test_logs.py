"""Log records as text and as JSON, one line each."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Iterator

import pytest

from vaoi_station.runs.host.logs import JSON_VARIABLE, JsonLines, configure_logging


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
