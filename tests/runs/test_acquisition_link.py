"""The link to the acquisition process: deaths, silence, restarts."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import pytest

from vaoi_station.acquisition.messages import Disarm, Ready, Shutdown, Trouble
from vaoi_station.runs import acquisition_link as module
from vaoi_station.runs.acquisition_link import AcquisitionLink, longest_s

PATIENCE_S = 20.0


class Ears:
    """What the link reports."""

    def __init__(self) -> None:
        self.heard: queue.Queue[Any] = queue.Queue()
        self.lost: queue.Queue[str] = queue.Queue()


@pytest.fixture
def ears() -> Ears:
    return Ears()


@pytest.fixture
def link(peer: Any, ears: Ears) -> Iterator[AcquisitionLink]:
    made = AcquisitionLink(peer.launch)
    made.start(ears.heard.put, ears.lost.put)
    peer.life(1)
    yield made
    ending = threading.Thread(target=made.stop, args=(PATIENCE_S,))
    ending.start()
    peer.close()
    ending.join()


def test_commands_go_down_and_reports_come_up(link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    link.send(Disarm())
    peer.expect(Disarm)
    peer.say(Ready(3))
    assert ears.heard.get(timeout=PATIENCE_S) == Ready(3)
    status = link.status()
    assert status.alive
    assert status.heartbeat_age_s is not None


def test_a_death_is_told_and_followed_by_a_new_life(link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    peer.say(Ready(3))
    assert ears.heard.get(timeout=PATIENCE_S)
    peer.die(-11)
    assert "the acquisition process ended (code -11)" in ears.lost.get(timeout=PATIENCE_S)
    link.send(Disarm())
    peer.life(2)
    peer.say(Ready(3))
    assert ears.heard.get(timeout=PATIENCE_S) == Ready(3)
    assert link.status().restarts == 1


def test_last_words_are_heard(link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    for n in range(50):
        peer.say(Ready(n))
    peer.die()
    ears.lost.get(timeout=PATIENCE_S)
    assert ears.heard.qsize() == 50


def test_who_cannot_begin_or_dies_as_soon_as_it_is_ready_is_started_again_ever_more_slowly(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, ears: Ears
) -> None:
    pauses: list[float] = []
    fails = link._backoff.fails

    def fails_briefly(longest_s: float | None = None) -> float:
        pauses.append(fails(longest_s))
        link._backoff.due_s = None
        return 0.0

    monkeypatch.setattr(link._backoff, "fails", fails_briefly)
    for life in range(1, 7):
        peer.life(life)
        peer.say(Ready(3)) if life in (3, 4) else peer.say(Trouble("port-absent", "There is no serial port.", ""))
        peer.die(0)
        told = ears.lost.get(timeout=PATIENCE_S)
        assert told == (
            "the acquisition process ended (code 0)" if life in (3, 4) else "the acquisition process could not begin"
        )
    peer.life(7)
    assert pauses == [0.5, 1, 2, 4, 6, 6]


def test_a_life_that_has_proven_itself_is_followed_by_another_at_once(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, ears: Ears
) -> None:
    now_s = time.monotonic()
    monkeypatch.setattr(link._backoff, "_clock", lambda: now_s)
    for life in (1, 2):
        peer.life(life)
        peer.say(Ready(3))
        ears.heard.get(timeout=PATIENCE_S)
        now_s += module.PACE.proven_s
        peer.die(-11)
        ears.lost.get(timeout=PATIENCE_S)
        assert link._backoff.due_s in (None, now_s + module.PACE.first_s)
        now_s += module.PACE.first_s


def test_when_it_is_started_again_is_told(link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    assert link.status().next_try is None
    for life in (1, 2, 3):
        peer.life(life)
        peer.say(Trouble("setting-refused", "Camera left refuses Gain = 99.", ""))
        peer.die(0)
        ears.lost.get(timeout=PATIENCE_S)
    status = link.status()
    assert not status.alive
    assert status.next_try is not None
    assert 0 < (datetime.fromisoformat(status.next_try) - datetime.now(UTC)).total_seconds() < 2.1
    peer.life(4)
    assert link.status().next_try is None


def test_what_is_plugged_in_is_taken_within_seconds_and_what_was_refused_is_not_hurried() -> None:
    assert longest_s("port-absent") == longest_s("camera-in-use") == 6
    assert longest_s("invalid-input") == longest_s("setting-refused") == longest_s("") == 60


def test_silence_is_death(monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    monkeypatch.setattr(module, "SILENCE_S", 0.2)
    peer.say(Ready(3))
    ears.heard.get(timeout=PATIENCE_S)
    assert "gave no sign of life" in ears.lost.get(timeout=PATIENCE_S)
    assert peer.lives[0][0].exitcode == -9


def test_the_end_is_asked_for_and_waited_for(link: AcquisitionLink, peer: Any, ears: Ears) -> None:
    ending = threading.Thread(target=link.stop, args=(PATIENCE_S,))
    ending.start()
    peer.expect(Shutdown)
    peer.die(0)
    ending.join(PATIENCE_S)
    assert not ending.is_alive()
    assert ears.lost.empty()
    assert len(peer.lives) == 1


def test_who_does_not_end_is_ended(link: AcquisitionLink, peer: Any) -> None:
    link.stop(0.05)
    assert peer.lives[0][0].exitcode == -9
    link.stop()
