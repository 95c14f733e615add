"""What a transport does for the delivery: it sends one message and reports what became of it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from vaoi_station.push.messages import Message


class Outcome(NamedTuple):
    """What became of one attempt."""

    delivered: bool
    detail: str
    """The receiver's status, or why there was none; without any content of its answer."""
    retry_after_s: float = 0.0
    """Pause that the receiver asks for, s."""
    gone: bool = False
    """Whether the receiver wants no more messages."""


class Transport(Protocol):
    """Sends messages to one receiver. One thread calls it. Each call ends within a bounded time."""

    def send(self, message: Message) -> Outcome:
        """Send one message; return when the receiver has accepted it, or when it is clear that it did not."""

    def idle(self) -> Outcome | None:
        """Do what the connection needs while there is nothing to send; called about once a second.

        Returns what became of an attempt to connect; None if there was none.
        """

    def close(self) -> None:
        """Close the connection."""
