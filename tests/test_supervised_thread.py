"""Threads whose end or hang is a fault."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import threading
import time
import weakref
from contextlib import suppress

import pytest

from vaoi_station.supervised_thread import URGENT_NICE, SupervisedThread, faults_of

PATIENCE_S = 10.0


def kill(thread: threading.Thread) -> None:
    """Raise SystemExit in a thread, which ends threads without a word."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit))


def test_a_thread_that_is_killed_or_returns_is_a_fault() -> None:
    release = threading.Event()

    def loop() -> None:
        while not release.wait(0.01):
            killed.beat()

    killed = SupervisedThread(loop, "killed")
    killed.start()
    kill(killed)
    killed.join(PATIENCE_S)
    returned = SupervisedThread(lambda: None, "returned")
    returned.start()
    returned.join(PATIENCE_S)
    assert [str(fault) for fault in faults_of((killed, returned))] == [
        "Thread 'killed' has ended (SystemExit).",
        "Thread 'returned' has ended without an error.",
    ]


@pytest.mark.parametrize("resting", [False, True])
def test_silence_is_a_fault_unless_the_thread_waits_for_work(resting: bool) -> None:
    began, release = threading.Event(), threading.Event()

    def work() -> None:
        if resting:
            thread.rest()
        began.set()
        release.wait(PATIENCE_S)
        thread.beat()
        began.set()
        again.wait(PATIENCE_S)

    again = threading.Event()
    thread = SupervisedThread(work, "work", limit_s=0.05)
    thread.start()
    assert began.wait(PATIENCE_S)
    until_s = time.monotonic() + 0.2
    while time.monotonic() < until_s and thread.fault() is None:
        continue
    fault = thread.fault()
    assert (fault is None) == resting
    assert resting or re.search(r"hangs for \d+ s", str(fault))
    began.clear()
    release.set()
    assert began.wait(PATIENCE_S)
    again.set()
    thread.join(PATIENCE_S)


def test_a_thread_is_at_rest_only_while_it_waits() -> None:
    waits, released = threading.Event(), threading.Event()

    def work() -> None:
        with thread.waiting():
            waits.set()
            released.wait(PATIENCE_S)
        works.set()
        ended.wait(PATIENCE_S)

    works, ended = threading.Event(), threading.Event()
    thread = SupervisedThread(work, "work", limit_s=0.0)
    thread.start()
    assert waits.wait(PATIENCE_S)
    assert thread.fault() is None
    released.set()
    assert works.wait(PATIENCE_S)
    assert "hangs for" in str(thread.fault())
    thread.expect_end()
    ended.set()
    thread.join(PATIENCE_S)


def test_a_thread_that_has_ended_does_not_keep_its_owner() -> None:
    class Owner:
        def __init__(self) -> None:
            self.thread = SupervisedThread(self.work, "work")

        def work(self) -> None:
            """Do nothing."""

    owner = Owner()
    owner.thread.start()
    owner.thread.join(PATIENCE_S)
    gone = weakref.ref(owner)
    gc.disable()
    try:
        del owner
        assert gone() is None
    finally:
        gc.enable()


def test_an_urgent_thread_goes_before_others_where_the_system_allows_it() -> None:
    def niceness() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    def raise_priority() -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), URGENT_NICE)
        found.append(niceness())

    found, usual = list[int](), niceness()
    for thread in (
        threading.Thread(target=raise_priority),
        SupervisedThread(lambda: found.append(niceness()), "urgent", urgent=True),
        SupervisedThread(lambda: found.append(niceness()), "other"),
    ):
        thread.start()
        thread.join(PATIENCE_S)
    allowed, urgent, other = found
    assert (urgent, other) == (allowed, usual)
