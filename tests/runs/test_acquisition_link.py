"""The link to the acquisition process: deaths, silence, restarts."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from vaoi_station.acquisition.messages import Disarm, Ready, Shutdown, Trouble
from vaoi_station.runs import acquisition_link as module
from vaoi_station.runs.acquisition_link import AcquisitionLink, pause_s

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


def test_who_tells_why_it_cannot_begin_is_started_again_ever_more_slowly(
    monkeypatch: pytest.MonkeyPatch, link: AcquisitionLink, peer: Any, ears: Ears
) -> None:
    pauses: list[tuple[int, str]] = []

    def no_pause_s(failures: int, cause: str) -> float:
        pauses.append((failures, cause))
        return 0.0

    monkeypatch.setattr(module, "pause_s", no_pause_s)
    for life in range(1, 5):
        peer.life(life)
        peer.say(Ready(3)) if life == 3 else peer.say(Trouble("port-absent", "There is no serial port.", ""))
        peer.die(0)
        told = ears.lost.get(timeout=PATIENCE_S)
        assert told == (
            "the acquisition process ended (code 0)" if life == 3 else "the acquisition process could not begin"
        )
    peer.life(5)
    assert pauses == [(1, "port-absent"), (2, "port-absent"), (0, ""), (1, "port-absent")]


def test_what_is_plugged_in_is_taken_within_seconds_and_wrong_input_is_not_hurried() -> None:
    assert [pause_s(n, "port-absent") for n in range(6)] == [0.5, 1, 2, 4, 6, 6]
    assert [pause_s(n, "invalid-input") for n in range(1, 8)] == [1, 2, 4, 8, 16, 30, 30]
    assert pause_s(10**6, "setting-refused") == 6, "after days as after a minute"


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
