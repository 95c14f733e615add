"""Cuts the stream of a neighbour into messages: one packet may hold several, and one message may come in many."""

from __future__ import annotations

import re

from vaoi_station.hermes.messages import MOST_BYTES, ProtocolError

_BEGIN = re.compile(rb"<Hermes[\s/>]")
_END = re.compile(rb"</Hermes\s*>")
_TAIL = 16
"""Bytes before the newest ones in which a beginning or an end may have begun."""


class Framing:
    """Collects the bytes of one connection. At most one message that is not whole yet is kept."""

    def __init__(self) -> None:
        self._kept = bytearray()
        self._searched = 0
        """Number of bytes that were kept before and hold no end."""

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes of the stream; return the messages that are whole now.

        Raises:
            ProtocolError: more than the longest message came without an end of it; nothing is kept.
        """
        self._kept += data
        found = []
        while (message := self._take()) is not None:
            found.append(message)
        if len(self._kept) > MOST_BYTES:
            self._kept.clear()
            raise ProtocolError(f"a message has more than {MOST_BYTES} bytes")
        return found

    def _take(self) -> bytes | None:
        end = _END.search(self._kept, max(0, self._searched - _TAIL))
        if end is None:
            self._searched = len(self._kept)
            # White space between messages is no part of one.
            if self._kept[:1].isspace():
                self._kept = self._kept.lstrip()
                self._searched = len(self._kept)
            return None
        begin = _BEGIN.search(self._kept, 0, end.start())
        first = begin.start() if begin else 0
        if b"<!" in self._kept[:first]:
            raise ProtocolError("the message has a document type or a comment, which the standard does not know")
        message = bytes(self._kept[first : end.end()])
        del self._kept[: end.end()]
        self._searched = 0
        if len(message) > MOST_BYTES:
            raise ProtocolError(f"a message has {len(message)} bytes, but must have at most {MOST_BYTES}")
        return message
