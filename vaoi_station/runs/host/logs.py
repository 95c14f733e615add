"""Logging to standard output, one line per record, as text or JSON; the same in every process."""

from __future__ import annotations

import json
import logging
import os
import sys

JSON_VARIABLE = "VAOI_LOG_JSON"
"""Environment variable that selects JSON; child processes inherit it."""


class JsonLines(logging.Formatter):
    """Formatter that writes a record as one JSON object."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as JSON: time, level, logger, process, message, exception."""
        entry = {
            "time": self.formatTime(record, "%Y-%m-%dT%H:%M:%S") + f".{int(record.msecs):03d}",
            "level": record.levelname.lower(),
            "logger": record.name.removeprefix("vaoi_station."),
            "process": record.processName,
            "message": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


def configure_logging(as_json: bool | None = None) -> None:
    """Log to standard output; None takes the format of the process that started this one."""
    if as_json is not None:
        os.environ[JSON_VARIABLE] = "1" if as_json else ""
    # Standard output, not a file: systemd and containers collect and rotate it.
    handler = logging.StreamHandler(sys.stdout)
    if os.environ.get(JSON_VARIABLE):
        handler.setFormatter(JsonLines())
    else:
        handler.setFormatter(logging.Formatter("%(levelname)s %(processName)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
