"""The link to the acquisition process: deaths, silence, restarts."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from vaoi_station.acquisition.process.messages import Disarm, Ready, Shutdown, Trouble
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.runs.control import acquisition_link as module
from vaoi_station.runs.control.acquisition_link import AcquisitionLink, longest_s
from vaoi_station.runs.states.schemas import STARTING, WAITING

PATIENCE_S = 20.0
ROUNDED = timedelta(milliseconds=100)


class Recorded:
    """Records the events of the link."""

    def __init__(self) -> None:
        self.messages: queue.Queue[Any] = queue.Queue()
        self.ends: queue.Queue[str] = queue.Queue()

    def acquisition_message(self, message: Any) -> None:
        self.messages.put(message)

    def acquisition_ended(self, description: str) -> None:
        self.ends.put(description)

    def worker_reply(self, *_: object) -> None:
        raise AssertionError("the link has no workers")

    worker_ended = workers_ready = worker_reply


@pytest.fixture
def events() -> Recorded:
    return Recorded()


@pytest.fixture
def unstarted(peer: Any) -> Iterator[AcquisitionLink]:
    made = AcquisitionLink(peer.launch)
    yield made
    ending = threading.Thread(target=made.stop, args=(PATIENCE_S,))
    ending.start()
    peer.close()
    ending.join()


@pytest.fixture
def link(unstarted: AcquisitionLink, peer: Any, events: Recorded) -> AcquisitionLink:
    unstarted.start(events)
    peer.life(1)
    return unstarted


def test_commands_go_down_and_reports_come_up(link: AcquisitionLink, peer: Any, events: Recorded) -> None:
    link.send(Disarm())
    peer.expect(Disarm)
    peer.say(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S) == Ready(3)
    status = link.status()
    assert status.alive
    assert status.heartbeat_age_s is not None


def test_before_it_is_begun_it_waits_for_the_workers_and_says_so(
    unstarted: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    warm = threading.Event()
    unstarted.start(events, warm.is_set)
    status = unstarted.status()
    assert (status.doing, status.pid, status.alive) == (WAITING, None, False)
    warm.set()
    peer.life(1)
    peer.say(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S) == Ready(3)
    status = unstarted.status()
    assert (status.doing, status.alive) == ("", True)
    peer.die()
    events.ends.get(timeout=PATIENCE_S)
    assert unstarted.status().doing in ("", STARTING), "it waits no longer for them"


def test_a_death_is_told_and_followed_by_a_new_life(link: AcquisitionLink, peer: Any, events: Recorded) -> None:
    peer.say(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S)
    peer.die(-11)
    assert "the acquisition process ended (code -11)" in events.ends.get(timeout=PATIENCE_S)
    link.send(Disarm())
    peer.life(2)
    peer.say(Ready(3))
    assert events.messages.get(timeout=PATIENCE_S) == Ready(3)
    assert link.status().restarts == 1


def test_last_words_are_heard(link: AcquisitionLink, peer: Any, events: Recorded) -> None:
    for n in range(50):
        peer.say(Ready(n))
    peer.die()
    events.ends.get(timeout=PATIENCE_S)
    assert events.messages.qsize() == 50


def test_who_cannot_begin_or_dies_as_soon_as_it_is_ready_is_started_again_ever_more_slowly(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    pauses: list[float] = []
    record_failure = link._backoff.record_failure

    def fails_briefly(longest_s: float | None = None) -> float:
        pauses.append(record_failure(longest_s))
        link._backoff.due_s = None
        return 0.0

    monkeypatch.setattr(link._backoff, "record_failure", fails_briefly)
    for life in range(1, 7):
        peer.life(life)
        peer.say(Ready(3)) if life in (3, 4) else peer.say(Trouble("port-absent", "There is no serial port.", ""))
        peer.die(0)
        told = events.ends.get(timeout=PATIENCE_S)
        assert told == (
            "the acquisition process ended (code 0)" if life in (3, 4) else "the acquisition process could not begin"
        )
    peer.life(7)
    assert pauses == [0.5, 1, 2, 4, 6, 6]


def test_a_life_that_has_proven_itself_is_followed_by_another_at_once(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    now_s = time.monotonic()
    monkeypatch.setattr(link._backoff, "_clock", lambda: now_s)
    for life in (1, 2):
        peer.life(life)
        peer.say(Ready(3))
        events.messages.get(timeout=PATIENCE_S)
        now_s += module.PACE.proven_s
        peer.die(-11)
        events.ends.get(timeout=PATIENCE_S)
        assert link._backoff.due_s in (None, now_s + module.PACE.first_s)
        now_s += module.PACE.first_s


def test_when_it_is_started_again_is_told(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, events: Recorded
) -> None:
    assert link.status().next_try is None
    peer.die(0)
    peer.life(2)
    assert link.status().next_try is None, "it is being started"
    monkeypatch.setattr(link._backoff, "_pace", BackoffPolicy(first_s=60.0, longest_s=60.0, proven_s=30.0))
    before = datetime.now(UTC)
    peer.say(Trouble("setting-refused", "Camera left refuses Gain = 99.", ""))
    peer.die(0)
    for _ in range(2):
        events.ends.get(timeout=PATIENCE_S)
    status = link.status()
    assert not status.alive
    assert status.next_try is not None
    failed = datetime.fromisoformat(status.next_try) - timedelta(seconds=60)
    assert before - ROUNDED < failed < datetime.now(UTC) + ROUNDED


def test_what_is_plugged_in_is_taken_within_seconds_and_what_was_refused_is_not_hurried() -> None:
    assert longest_s("port-absent") == longest_s("camera-in-use") == 6
    assert longest_s("invalid-input") == longest_s("setting-refused") == longest_s("") == 60


def test_silence_is_death(monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, events: Recorded) -> None:
    monkeypatch.setattr(module, "SILENCE_S", 0.2)
    peer.say(Ready(3))
    events.messages.get(timeout=PATIENCE_S)
    assert "gave no sign of life" in events.ends.get(timeout=PATIENCE_S)
    assert peer.lives[0][0].exitcode == -9


def test_the_end_is_asked_for_and_waited_for(link: AcquisitionLink, peer: Any, events: Recorded) -> None:
    ending = threading.Thread(target=link.stop, args=(PATIENCE_S,))
    ending.start()
    peer.expect(Shutdown)
    peer.die(0)
    ending.join(PATIENCE_S)
    assert not ending.is_alive()
    assert events.ends.empty()
    assert len(peer.lives) == 1


def test_who_does_not_end_is_ended(link: AcquisitionLink, peer: Any) -> None:
    link.stop(0.05)
    assert peer.lives[0][0].exitcode == -9
    link.stop()
