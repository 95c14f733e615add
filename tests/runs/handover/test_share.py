"""A share that fails or hangs in the middle of an addition costs no board, no run and no end of the station."""

from __future__ import annotations

import errno
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from tests.needs import lacking
from tests.peers.share import Share
from tests.runs.handover.test_handover import Line
from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive
from vaoi_station.runs.handover import adder
from vaoi_station.runs.handover import handover as module

STATION_THAT_ENDS = """
import subprocess
import sys
from pathlib import Path
from vaoi_station.runs.handover.adder import Addition, launch_adder
if __name__ == "__main__":
    pipe, process = launch_adder()
    pipe.send(Addition(sys.argv[1], Path("absent"), "one"))
    sys.stdin.readline()
    process.kill()
    try:
        process.wait(0.1)
        print("ended")
    except subprocess.TimeoutExpired:
        print("blocked")
"""
PATIENCE_S = 120.0
"""Longest wait; a process starts, compiles and has the lowest priority."""


@pytest.fixture
def share(tmp_path: Path) -> Iterator[Share]:
    """Return a share that works, with an empty archive."""
    try:
        made = Share(tmp_path / "share")
    except OSError as error:
        lacking(f"{error.strerror} (CAP_SYS_ADMIN and /dev/fuse)")
    (made.seen_from_here / "archive.json").write_text('{"format": "vaoi-archive", "version": 1}')
    yield made
    made.close()


@pytest.fixture
def launch(share: Share, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """Return a function that starts the adder where it sees the share."""

    def start() -> tuple[Connection[Any, Any], subprocess.Popen[bytes]]:
        popen = subprocess.Popen
        with monkeypatch.context() as patch:
            patch.setattr(subprocess, "Popen", lambda command, **how: popen([*share.prefix, *command], **how))
            return adder.launch_adder()

    return start


def test_runs_wait_for_a_share_that_fails_or_hangs_and_boards_do_not(
    make_rig: Callable[..., Any], share: Share, launch: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    rig.ready()
    line, runs = Line(rig, share.directory), list[str]()
    wait = partial(rig.wait_for, patience_s=PATIENCE_S)
    with line.running(launch=launch) as handover:
        for number in (errno.EIO, errno.ESTALE, errno.ENOSPC, errno.EROFS):
            # After the note that the run is being added, in the middle of the next write.
            share.order(f"after 1 fail {number}")
            runs.append(line.board(Status.FAILED).id)
            wait(lambda: handover.reasons() != (), "the warning")
            assert handover.reasons()[0].code == "archive-waits"
            assert handover.status().refused == 0
            share.order("work")
            wait(lambda: handover.status().added == len(runs), "the run is in the archive")
        share.order("after 1 hang")
        runs.append(line.board(Status.FAILED).id)
        share.order("blocked")
        # Only now: a shorter silence would end the adder while it starts.
        monkeypatch.setattr(module, "SILENCE_S", 0.5)
        wait(lambda: "does not answer" in handover.status().problem, "the share hangs")
        blocked = handover._ended
        assert blocked is not None
        assert blocked.poll() is None
        runs.append(line.board(Status.FAILED).id)
        wait(lambda: handover.status().waiting == 2, "the next board is filmed and kept")
        assert handover.thread.fault() is None
    assert blocked.poll() is None, "the station has ended before the share answers"
    share.order("work")
    blocked.wait(PATIENCE_S)
    with line.running(launch=launch) as handover:
        wait(lambda: handover.status().added == len(runs), "all runs are in the archive")
    archive = Archive.open(share.seen_from_here)
    assert [run.run for run in archive.runs()] == sorted(runs)
    assert archive.verify().faults == 0


def test_a_station_ends_while_a_share_blocks_its_adder(share: Share) -> None:
    command = [*share.prefix, sys.executable, "-c", STATION_THAT_ENDS, str(share.directory)]
    share.order("hang")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as station:
        assert station.stdin is not None
        assert station.stdout is not None
        try:
            share.order("blocked")
            station.stdin.write("\n")
            station.stdin.flush()
            assert station.stdout.readline() == "blocked\n"
            # Not `communicate`: the adder has the other end of stdout as long as it is blocked.
            station.wait(PATIENCE_S)
        finally:
            share.order("work")
    assert station.returncode == 0
