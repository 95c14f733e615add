"""Device processes end with their standard input, or are killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from vaoi_station.rig.chip import DEVICE_NICENESS, raise_priority, stop_process

Start = Callable[[str], "subprocess.Popen[str]"]
READ_TO_THE_END = "import sys; print('up', flush=True); sys.stdin.read()"
NEVER_END = "import signal; print('up', flush=True); signal.pause()"


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a Python program and wait for its first line."""
    started: list[subprocess.Popen[str]] = []

    def run(program: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        return process

    yield run
    for process in started:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None and not pipe.closed:
                pipe.close()


def test_a_process_ends_with_its_standard_input(start: Start) -> None:
    process = start(READ_TO_THE_END)
    stop_process(process, 20.0)
    assert process.returncode == 0


def test_a_process_that_does_not_end_is_killed(start: Start) -> None:
    process = start(NEVER_END)
    stop_process(process, 0.05)
    assert process.returncode == -signal.SIGKILL


def test_a_process_that_has_ended_is_reaped(start: Start) -> None:
    process = start(READ_TO_THE_END)
    assert process.stdin is not None
    process.stdin.write("text that the process never reads")
    os.kill(process.pid, signal.SIGKILL)
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    stop_process(process, 20.0)
    assert process.returncode == -signal.SIGKILL


def test_the_priority_is_raised_where_that_is_permitted(start: Start) -> None:
    process = start(READ_TO_THE_END)
    before = os.getpriority(os.PRIO_PROCESS, process.pid)
    raise_priority(process.pid)
    assert os.getpriority(os.PRIO_PROCESS, process.pid) in (before, DEVICE_NICENESS)


def test_without_permission_the_priority_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    raise_priority(os.getpid())
