"""Reads what a plane is stored as, part by part."""

from __future__ import annotations


class PlaneReader:
    """Bytes that are taken one part after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def take(self, size: int) -> bytes:
        """Return the next bytes; ValueError if there are fewer."""
        part = self._content[self._at : self._at + size]
        self._at += size
        if len(part) < size:
            raise ValueError("a plane is shorter than its head says")
        return part
