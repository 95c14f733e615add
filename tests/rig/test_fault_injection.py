"""What the saboteur does to processes, and that it lets go of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from vaoi_station.rig.fault_injection import Back, Saboteur, mischief_of
from vaoi_station.rig.line.faults import parse_fault


@pytest.fixture
def victim() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE) as process:
        yield process
        process.kill()


def test_what_was_stopped_runs_on_even_if_nobody_waits(victim: subprocess.Popen[bytes]) -> None:
    """The rig is taken down in the middle of a stop of a minute."""
    with Saboteur([parse_fault("stall:who=acquisition,board=0,row=1,for_s=60")]) as saboteur:
        saboteur.ask_for_processes(lambda: {"acquisition": victim.pid})
        saboteur.noticed(0, 0)
        assert saboteur.troubles == []
        saboteur.noticed(0, 1)
        assert os.waitpid(victim.pid, os.WUNTRACED)[0] == victim.pid
    _, status = os.waitpid(victim.pid, os.WCONTINUED)
    assert os.WIFCONTINUED(status)
    [trouble], [back] = saboteur.troubles, saboteur.backs
    assert trouble.why == "the acquisition process was stopped"
    saboteur.mend(back, 12345)
    assert saboteur.troubles[0].until_ns == 12345


def test_a_station_that_was_stopped_is_no_excuse(victim: subprocess.Popen[bytes]) -> None:
    with Saboteur([parse_fault("stall:board=0,row=0,for_s=0.01")]) as saboteur:
        saboteur.ask_for_processes(lambda: {"station": victim.pid})
        saboteur.noticed(0, 0)
        saboteur.noticed(0, 0)
        saboteur.over()
    assert saboteur.troubles == []
    assert [type(back) for back in saboteur.backs] == [Back]
    assert saboteur.failed == []
    victim.send_signal(signal.SIGTERM)
    assert victim.wait(10) == -signal.SIGTERM


def test_what_never_happened_is_told() -> None:
    with Saboteur([parse_fault("reset:board=2,row=99"), parse_fault("loss")]) as saboteur:
        saboteur.over()
    assert saboteur.failed == ["reset did not happen: board 2 had no row 99"]


def test_a_process_that_is_not_there_is_told() -> None:
    with Saboteur([parse_fault("stall:who=worker 7,board=0,row=0")]) as saboteur:
        saboteur.noticed(0, 0)
    assert saboteur.failed == ["the station has no process 'worker 7' to stop"]


def test_mischief_is_what_the_stage_does_by_itself() -> None:
    words = ("loss:share=0.2", "ignored:camera=1,board=0,row=3", "kill")
    mischief = mischief_of([parse_fault(word) for word in words])
    assert (mischief.loss, mischief.ignored) == (0.2, frozenset({(0, 3, 1)}))
