"""Logging to standard output, as text or as one JSON object per line. All processes of the station log in this way."""

from __future__ import annotations

import json
import logging
import os
import sys

from vaoi_station.runs.host.journal import JournalHandler, PriorityPrefix, fields_of, is_journal
from vaoi_station.runs.host.log_repeats import RepeatLimit

IDENTIFIER = "vaoi"
"""Name of the program in the journal."""
TEXT = "%(levelname)s %(processName)s %(name)s: %(message)s"
JSON_VARIABLE = "VAOI_LOG_JSON"
"""Environment variable that selects JSON if it is not empty; child processes inherit it."""


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
            **fields_of(record),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


def configure_logging(as_json: bool | None = None) -> None:
    """Configure logging to standard output, as JSON or as text. None selects the format of the parent process.

    If standard output is systemd's journal, records have a priority. Text is sent with fields, by the journal's own
    protocol. JSON is written as lines with a prefix.
    """
    if as_json is not None:
        os.environ[JSON_VARIABLE] = "1" if as_json else ""
    logging.basicConfig(level=logging.INFO, handlers=[_handler(bool(os.environ.get(JSON_VARIABLE)))])


def _handler(as_json: bool) -> logging.Handler:
    journal = is_journal(os.environ, 1)
    handler: logging.Handler
    if journal and not as_json:
        handler = JournalHandler(IDENTIFIER)
    else:
        # Standard output and not a file, because systemd and containers collect and rotate it.
        handler = logging.StreamHandler(sys.stdout)
        formatter = JsonLines() if as_json else logging.Formatter(TEXT)
        handler.setFormatter(PriorityPrefix(formatter) if journal else formatter)
    handler.addFilter(RepeatLimit())
    return handler
