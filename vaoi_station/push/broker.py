"""What every connection to a broker offers to the publisher."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

from vaoi_station.runs.states.schemas import EventRecord

LIMIT_S = 10.0
"""Longest wait for the broker's reply to a connection or a message, s."""
OWN_KIND = "push"
"""Kind of the events about the broker. They are not published: a broker that fails would cause messages without end."""


class Outcome(NamedTuple):
    """What became of one attempt to publish or to connect."""

    delivered: bool
    detail: str
    """Why it failed."""


class Broker(ABC):
    """A broker; one thread calls it."""

    what: str
    """What kind of broker it is, in messages."""
    code: str
    """Code of the warning about a broker that is lost."""
    kinds: Sequence[str] = ()
    """Types of events that it gets; empty for all."""

    def tend(self) -> None:  # noqa: B027  most have nothing to do
        """Do what is due whether or not the broker is there; called at least twice a second."""

    @abstractmethod
    def send(self, record: EventRecord) -> Outcome:
        """Publish one event; return when the broker has acknowledged it."""

    @abstractmethod
    def idle(self) -> Outcome | None:
        """Keep up the connection while there are no events; an outcome if it failed or was made anew."""

    @abstractmethod
    def close(self) -> None:
        """Take leave of the broker, and disconnect."""
