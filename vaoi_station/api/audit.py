"""The audit log: every command, and every refusal because of a missing key, as lines of JSON in `audit.jsonl`."""

from __future__ import annotations

import json
import logging
import queue
import threading
from collections import deque
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vaoi_station.files.access_keys import append_entry
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

MOST_BYTES, FILES_KEPT = 8 * 2**20, 4
"""Size in bytes at which a new file is begun, and number of earlier files that are kept."""
WRITE_LIMIT_S = 600.0
"""Longest time for the writing of one entry. After this time, the thread counts as hung."""
READ_WAIT_S = 5.0
"""Longest wait of a reader for the entries that are not written yet."""
RETRY_S = 1.0
"""Pause before an entry that the disk has refused is written again, s."""
_MOST_WAITING = 2000
"""Largest number of entries that wait for the disk; of those beyond it, only the number is written."""


class AuditLog:
    """The audit log. A separate thread writes the entries, so that a slow disk delays no request.

    Entries that a full disk refuses wait in memory, and are written when there is room.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self.path, self._most_bytes = path, most_bytes
        self._waiting: queue.Queue[dict[str, Any] | None] = queue.Queue(_MOST_WAITING)
        self._dropped = 0
        self._refused = False
        """Whether the disk refuses entries: no reader waits for what it refuses."""
        self._closing = threading.Event()
        self.thread = SupervisedThread(self._run, "audit", WRITE_LIMIT_S)
        self.thread.start()

    def add(self, **entry: object) -> None:
        """Write an entry, with the present time."""
        record = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **entry}
        if self._dropped:
            record["dropped_before"] = self._dropped
        try:
            self._waiting.put_nowait(record)
            self._dropped = 0
        except queue.Full:
            # The disk is too slow. The next entry that is written states how many are missing.
            self._dropped += 1

    def newest(self, count: int) -> list[dict[str, Any]]:
        """Return the newest entries of the present file and the one before, newest first."""
        # Not `join`: it would wait for ever for a disk that hangs.
        with self._waiting.all_tasks_done:
            self._waiting.all_tasks_done.wait_for(
                lambda: self._refused or not self._waiting.unfinished_tasks, READ_WAIT_S
            )
        lines: deque[str] = deque(maxlen=count)
        for path in (self._old(1), self.path):
            if path.is_file():
                with path.open(encoding="utf-8", errors="replace") as file:
                    lines.extend(file)
        entries = []
        for line in reversed(lines):
            with suppress(ValueError):  # a power failure may have cut the last line short
                entries.append(json.loads(line))
        return [entry for entry in entries if isinstance(entry, dict)]

    def close(self) -> None:
        """Write the waiting entries, and end the thread. What the disk refuses now is lost."""
        self.thread.expect_end()
        self._closing.set()
        # If the disk hangs, the queue may be full, and an unlimited `put` would never return.
        with suppress(queue.Full):
            self._waiting.put(None, timeout=READ_WAIT_S)
        self.thread.join(READ_WAIT_S)

    def _run(self) -> None:
        while True:
            with self.thread.waiting():
                record = self._waiting.get()
            while record is not None and not self._is_written(record) and not self._closing.is_set():
                with self.thread.waiting():
                    self._closing.wait(RETRY_S)
            self._waiting.task_done()
            if record is None:
                return

    def _is_written(self, record: dict[str, Any]) -> bool:
        refused = False
        try:
            self._write(record)
        except OSError as error:
            refused = True
            if not self._refused:
                _log.error("the audit log cannot be written: %s; it is tried again", error)
        with self._waiting.all_tasks_done:
            self._refused = refused
            self._waiting.all_tasks_done.notify_all()
        return not refused

    def _write(self, record: dict[str, Any]) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.exists() and self.path.stat().st_size > self._most_bytes:
            for n in range(FILES_KEPT, 1, -1):
                if self._old(n - 1).exists():
                    self._old(n - 1).replace(self._old(n))
            self.path.replace(self._old(1))
        append_entry(self.path, record)

    def _old(self, n: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{n}")
