"""The inbox executes messages in order, and no caller waits for ever."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from concurrent.futures import Future

import pytest

from vaoi_station.errors import InternalError, StateError
from vaoi_station.runs.run.inbox import Inbox


@pytest.fixture
def inbox() -> Iterator[Inbox]:
    made = Inbox(lambda: None)
    made.start()
    yield made
    made.close()


def test_internal_faults_are_raised_and_do_not_end_the_thread(inbox: Inbox, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR), pytest.raises(InternalError, match="ZeroDivisionError"):
        inbox.ask(lambda: 1 / 0)
    inbox.post(lambda: 1 / 0)
    assert inbox.ask(lambda: "alive") == "alive"
    assert caplog.text.count("ZeroDivisionError") >= 1


def test_after_close_requests_are_refused(inbox: Inbox) -> None:
    inbox.close()
    inbox.close()
    with pytest.raises(StateError, match="stopping"):
        inbox.ask(lambda: None)


def test_a_caller_that_waits_at_the_end_is_refused(inbox: Inbox) -> None:
    reported: list[Exception] = []
    asked = threading.Event()

    def wait() -> None:
        try:
            inbox.wait(Future(), asked.set)
        except StateError as error:
            reported.append(error)

    waiter = threading.Thread(target=wait)
    waiter.start()
    assert asked.wait(10)
    inbox.close()
    waiter.join(10)
    assert len(reported) == 1
