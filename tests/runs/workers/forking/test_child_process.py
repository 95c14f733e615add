"""A process that is watched by a pidfd."""

from __future__ import annotations

import os
import select
import signal
import subprocess

from vaoi_station.runs.workers.forking.child_process import ChildProcess


def test_its_end_is_seen_and_it_can_be_killed() -> None:
    with subprocess.Popen(["sleep", "1000"]) as started:
        process = ChildProcess(started.pid, os.pidfd_open(started.pid))
        assert not process.has_ended()
        process.kill()
        assert process.has_ended(60.0)
        assert select.select([process], [], [], 0)[0] == [process]
        assert started.wait() == -signal.SIGKILL
        process.kill()  # nothing is left to kill
        assert process.has_ended()
        assert process.exit_code is None, "only its parent knows it"
        process.close()
