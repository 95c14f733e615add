"""Events of the processes reach the coordinator's thread, pictures the thread that waits for them."""

from __future__ import annotations

import threading
from typing import Any

from vaoi_station.acquisition.process.messages import Ready
from vaoi_station.runs.control.inbox import Inbox
from vaoi_station.runs.control.inbox_events import InboxEvents
from vaoi_station.runs.workers.jobs import RenderJob, Reply


class RecordedCore:
    """Records calls with the name of their thread."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str, tuple[Any, ...]]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *values: self.calls.append((name, threading.current_thread().name, values))


def test_events_are_processed_in_order_in_the_coordinators_thread(inbox: Inbox) -> None:
    core: Any = RecordedCore()
    events = InboxEvents(inbox, core, core)
    events.acquisition_message(Ready(2))
    events.acquisition_ended("it ended")
    events.worker_ended("Worker 0 ended.")
    events.workers_ready()
    inbox.ask(lambda: None)
    names = [name for name, _, _ in core.calls]
    assert names == ["acquisition_message", "acquisition_ended", "worker_ended", "workers_ready"]
    assert {thread for _, thread, _ in core.calls} == {"coordinator"}
    assert core.calls[0][2] == (Ready(2),)


def test_replies_carry_the_time_of_their_arrival_and_pictures_skip_the_inbox(inbox: Inbox) -> None:
    core: Any = RecordedCore()
    pictures: Any = RecordedCore()
    events = InboxEvents(inbox, core, pictures)
    link: Any = object()
    view: Any = None
    reply = Reply(b"", None, 0.0)
    events.worker_reply(link, reply)
    events.worker_reply(RenderJob("r1", 0, 1, 2, view, "png", 7), reply)
    [(name, thread, _)] = pictures.calls
    assert (name, thread) == ("complete", threading.current_thread().name)
    inbox.ask(lambda: None)
    [(name, _, (job, received, at_s))] = core.calls
    assert (name, job, received) == ("worker_reply", link, reply)
    assert at_s > 0
