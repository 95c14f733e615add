"""One line per event to standard output: for people, or JSON for machines; the same in every process."""

from __future__ import annotations

import json
import logging
import os
import sys

JSON_VARIABLE = "VAOI_LOG_JSON"
"""Set in the environment, so that child processes log alike."""


class JsonLines(logging.Formatter):
    """A record as one JSON object."""

    def format(self, record: logging.LogRecord) -> str:
        """Time (UTC), level, who, and what."""
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
    """Log to standard output; without a word, as the station that started this process does."""
    if as_json is not None:
        os.environ[JSON_VARIABLE] = "1" if as_json else ""
    handler = logging.StreamHandler(sys.stdout)
    if os.environ.get(JSON_VARIABLE):
        handler.setFormatter(JsonLines())
    else:
        handler.setFormatter(logging.Formatter("%(levelname)s %(processName)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
