"""What the injector does to processes, and that it lets go of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from vaoi_station.rig.devices import DeviceRecovery, FaultInjector, frame_faults_of
from vaoi_station.rig.faults import parse_fault


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE) as process:
        yield process
        process.kill()


def test_a_stopped_process_resumes_at_the_end_of_the_context(process: subprocess.Popen[bytes]) -> None:
    """The rig is taken down in the middle of a stop of a minute."""
    with FaultInjector([parse_fault("stall:who=acquisition,board=0,row=1,for_s=60")]) as injector:
        injector.set_process_source(lambda: {"acquisition": process.pid})
        injector.on_row(0, 0)
        assert injector.outages == []
        injector.on_row(0, 1)
        assert os.waitpid(process.pid, os.WUNTRACED)[0] == process.pid
    _, status = os.waitpid(process.pid, os.WCONTINUED)
    assert os.WIFCONTINUED(status)
    [outage], [back] = injector.outages, injector.recoveries
    assert outage.reason == "the acquisition process was stopped"
    injector.close_outage(back, 12345)
    assert injector.outages[0].until_ns == 12345


def test_a_stopped_station_excuses_no_lost_frame(process: subprocess.Popen[bytes]) -> None:
    with FaultInjector([parse_fault("stall:board=0,row=0,for_s=0.01")]) as injector:
        injector.set_process_source(lambda: {"station": process.pid})
        injector.on_row(0, 0)
        injector.on_row(0, 0)
        injector.finish()
    assert injector.outages == []
    assert [type(back) for back in injector.recoveries] == [DeviceRecovery]
    assert injector.failed == []
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == -signal.SIGTERM


def test_a_fault_that_never_happened_is_reported() -> None:
    with FaultInjector([parse_fault("reset:board=2,row=99"), parse_fault("loss")]) as injector:
        injector.finish()
    assert injector.failed == ["reset did not happen: board 2 had no row 99"]


def test_a_missing_process_is_reported() -> None:
    with FaultInjector([parse_fault("stall:who=worker 7,board=0,row=0")]) as injector:
        injector.on_row(0, 0)
    assert injector.failed == ["the station has no process 'worker 7' to stop"]


def test_faults_of_frames_are_left_to_the_line() -> None:
    words = ("loss:share=0.2", "ignored:camera=1,board=0,row=3", "kill")
    frame_faults = frame_faults_of([parse_fault(word) for word in words])
    assert (frame_faults.loss, frame_faults.ignored) == (0.2, frozenset({(0, 3, 1)}))
