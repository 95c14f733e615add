"""Documents of runs that are read from the database once and kept in memory, the latest ones."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable


class KeptDocuments:
    """The latest documents of one kind, as bytes. Methods may be called from any thread."""

    def __init__(self, stored: Callable[[str], str | None], most: int) -> None:
        """Keep at most `most` documents; `stored` returns that of a run from the database, or None."""
        self._stored, self._most = stored, most
        self._known: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()
        """Guards `_known`; never held while the disk is awaited."""

    def get(self, run: str) -> bytes | None:
        """Return the document of a run from memory or the database."""
        with self._lock:
            if (found := self._known.get(run)) is not None:
                return found
        text = self._stored(run)
        return None if text is None else self.put(run, text.encode())

    def put(self, run: str, content: bytes) -> bytes:
        """Keep the document of a run, and return it."""
        with self._lock:
            self._known[run] = content
            if len(self._known) > self._most:
                self._known.popitem(last=False)
        return content
