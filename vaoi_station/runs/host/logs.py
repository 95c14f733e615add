"""Logging to standard output, as text or as one JSON object per line. All processes of the station log in this way."""

from __future__ import annotations

import json
import logging
import os
import sys

JSON_VARIABLE = "VAOI_LOG_JSON"
"""Environment variable that selects JSON if it is not empty; child processes inherit it."""


class JsonLines(logging.Formatter):
    """Formatter that writes each log record as one JSON object on one line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as a JSON object with time, level, logger, process, message and, if present, exception."""
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
    """Configure logging to standard output, as JSON or as text. None selects the format of the parent process."""
    if as_json is not None:
        os.environ[JSON_VARIABLE] = "1" if as_json else ""
    # Standard output, not a file: systemd and containers collect and rotate it.
    handler = logging.StreamHandler(sys.stdout)
    if os.environ.get(JSON_VARIABLE):
        handler.setFormatter(JsonLines())
    else:
        handler.setFormatter(logging.Formatter("%(levelname)s %(processName)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
