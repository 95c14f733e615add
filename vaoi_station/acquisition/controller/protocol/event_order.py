"""Events in order of their numbers, each once, whatever the line does to them."""

from __future__ import annotations

from vaoi_station.acquisition.controller.protocol.messages import Event


class EventOrder:
    """Holds back what came too early, and knows which number is next_number next."""

    def __init__(self) -> None:
        self.next_number = 0
        self._early: dict[int, Event] = {}
        self._announced = 0
        """All events before this number have happened."""

    def add(self, event: Event) -> list[Event]:
        """The events that are now complete up to here; none if this one is old or comes too early."""
        if event.number >= self.next_number:
            self._early[event.number] = event
            self.announce(event.number + 1)
        return self._release()

    def announce(self, count: int) -> None:
        """So many have happened, says the controller."""
        self._announced = max(self._announced, count)

    def missing(self) -> int | None:
        """Number to be read again, because later ones exist."""
        return self.next_number if self.next_number < self._announced else None

    def skip_to(self, number: int) -> tuple[int, list[Event]]:
        """Those before `number` are gone for ever; how many were, and what is complete without them."""
        lost = sum(k not in self._early for k in range(self.next_number, number))
        waiting = [self._early.pop(k) for k in sorted(self._early) if k < number]
        self.next_number = max(self.next_number, number)
        return lost, waiting + self._release()

    def _release(self) -> list[Event]:
        events: list[Event] = []
        while self.next_number in self._early:
            events.append(self._early.pop(self.next_number))
            self.next_number += 1
        return events
