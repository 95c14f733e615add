"""Restore the order of events: pass on each event once, by its number, although the port may lose or repeat events."""

from __future__ import annotations

from vaoi_station.acquisition.controller.protocol.messages import Event


class EventOrder:
    """Passes on each numbered event of the controller once, and in order.

    One object serves one boot of the controller, which numbers its messages from 0 after a reset.
    """

    def __init__(self) -> None:
        self.next_number = 0
        """Number of the next event to pass on."""
        self._early: dict[int, Event] = {}
        self._announced = 0
        """Number before which all events are known to have occurred, whether received or not."""

    def add(self, event: Event) -> list[Event]:
        """Add an event, and return the events that can be passed on now, in order.

        Return none if the event is a repeat, or if an earlier event is missing.
        """
        if event.number >= self.next_number:
            self._early[event.number] = event
            self.announce(event.number + 1)
        return self._release()

    def announce(self, count: int) -> None:
        """Record that the controller has numbered `count` events so far, so that lost events are noticed."""
        self._announced = max(self._announced, count)

    def missing(self) -> int | None:
        """Return the number of the next event if it was lost and must be read again; None if no event is missing."""
        return self.next_number if self.next_number < self._announced else None

    def skip_to(self, number: int) -> tuple[int, list[Event]]:
        """Give up the missing events before `number`. Return their count, and the events that can be passed on now."""
        lost = sum(k not in self._early for k in range(self.next_number, number))
        # Events that arrived early are not lost: they are passed on before those that follow the gap.
        waiting = [self._early.pop(k) for k in sorted(self._early) if k < number]
        self.next_number = max(self.next_number, number)
        return lost, waiting + self._release()

    def _release(self) -> list[Event]:
        events: list[Event] = []
        while self.next_number in self._early:
            events.append(self._early.pop(self.next_number))
            self.next_number += 1
        return events
