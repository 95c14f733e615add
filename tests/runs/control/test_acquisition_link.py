"""The link to the acquisition process: messages, unexpected ends, missing heartbeats, restarts."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from vaoi_station.acquisition.process.messages import Disarm, Ready, Trouble
from vaoi_station.backoff import Backoff
from vaoi_station.runs.control import acquisition_link as module
from vaoi_station.runs.control.acquisition_link import AcquisitionLink

PATIENCE_S = 20.0


class Recorded:
    """Records the events of the link."""

    def __init__(self) -> None:
        self.messages: queue.Queue[Any] = queue.Queue()
        self.ends: queue.Queue[str] = queue.Queue()


@pytest.fixture
def events() -> Recorded:
    return Recorded()


def end_link(link: AcquisitionLink, peer: Any) -> None:
    """Stop a link whose scripted process does not read Shutdown: it ends when it is closed."""
    ending = threading.Thread(target=link.stop, args=(PATIENCE_S,))
    ending.start()
    peer.close()
    ending.join()


@pytest.fixture
def unstarted(peer: Any) -> Iterator[AcquisitionLink]:
    made = AcquisitionLink(peer.launch)
    yield made
    end_link(made, peer)


@pytest.fixture
def link(unstarted: AcquisitionLink, peer: Any, events: Recorded) -> AcquisitionLink:
    unstarted.start(events.messages.put, events.ends.put)
    peer.wait_for_start(1)
    return unstarted


def test_an_unexpected_end_is_reported_and_followed_by_a_restart(
    link: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    peer.report(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S)
    peer.die(-11)
    assert "the acquisition process ended (code -11)" in events.ends.get(timeout=PATIENCE_S)
    link.send(Disarm())
    peer.wait_for_start(2)
    peer.report(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S) == Ready(3)
    assert link.status().restarts == 1


def test_what_a_process_reported_while_workers_warmed_up_is_not_lost_with_it(
    unstarted: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    unstarted.start(events.messages.put, events.ends.put, lambda: False)
    peer.wait_for_start(1)
    lost = Trouble("camera-lost", "Camera 1 is lost.", "Check its cable.")
    for report in (Ready(3), lost):
        peer.report(report)
    peer.die(1)
    assert events.ends.get(timeout=PATIENCE_S)
    assert events.messages.get_nowait() == lost, "it is not ready any more"
    assert events.messages.empty()


class RecordedBackoff(Backoff):
    """Records the pauses, and does not wait for them."""

    def __init__(self) -> None:
        super().__init__(module.PACE)
        self.pauses: list[float] = []

    def record_failure(self, longest_s: float | None = None) -> float:
        self.pauses.append(super().record_failure(longest_s))
        self.due_s = None
        return 0.0


@pytest.fixture
def start_link(peer: Any, events: Recorded) -> Iterator[Callable[[Backoff], AcquisitionLink]]:
    """Start links with a back-off of their own; they are stopped after the test."""
    started: list[AcquisitionLink] = []

    def start(backoff: Backoff) -> AcquisitionLink:
        made = AcquisitionLink(peer.launch, backoff)
        started.append(made)
        made.start(events.messages.put, events.ends.put)
        return made

    yield start
    for link in started:
        end_link(link, peer)


def test_a_process_that_cannot_start_or_ends_when_ready_is_restarted_ever_more_slowly(
    start_link: Callable[[Backoff], AcquisitionLink], peer: Any, events: Recorded
) -> None:
    backoff = RecordedBackoff()
    start_link(backoff)
    for attempt in range(1, 7):
        peer.wait_for_start(attempt)
        ready = attempt in (3, 4)
        peer.report(Ready(3) if ready else Trouble("port-absent", "There is no serial port.", ""))
        peer.die(0)
        expected = "ended (code 0)" if ready else "could not start"
        assert events.ends.get(timeout=PATIENCE_S) == f"the acquisition process {expected}"
    peer.wait_for_start(7)
    assert backoff.pauses == [0.5, 1, 2, 4, 6, 6]


def test_a_process_without_heartbeat_is_killed(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    monkeypatch.setattr(module, "HEARTBEAT_LIMIT_S", 0.2)
    peer.report(Ready(3))
    events.messages.get(timeout=PATIENCE_S)
    assert "sent no heartbeat" in events.ends.get(timeout=PATIENCE_S)
    assert peer.processes[0][0].exitcode == -9
