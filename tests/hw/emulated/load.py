"""A serial line that is full in both directions."""

from __future__ import annotations

from vaoi_station.acquisition.controller.protocol import Message, Type, encode


def full_line(milliseconds: int) -> bytes:
    """Requests that fill both directions of the line for a time; their replies are longer than they are."""
    questions = b"".join(encode(Message(Type.STATUS, k % 256)) for k in range(8)) + b"noise without an end, sometimes\0"
    return questions * (milliseconds * 23 // len(questions) + 1)
