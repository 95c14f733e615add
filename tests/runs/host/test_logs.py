"""One line per event."""

from __future__ import annotations

import json
import logging
import sys

from vaoi_station.runs.host.logs import JsonLines


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
