"""Names of processes, as other programs read them."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from vaoi_station.runs.host.process_setup import set_up_process


def child(connection: Connection[Any, Any]) -> None:
    set_up_process(one_thread=False)
    connection.send(os.getpid())
    connection.recv()


def test_a_child_process_shows_its_name_instead_of_how_it_was_started() -> None:
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=child, args=(there,), name="vaoi-worker-1", daemon=True)
    process.start()
    place = Path(f"/proc/{here.recv()}")
    command, comm = (place / "cmdline").read_bytes(), (place / "comm").read_text()
    here.send(None)
    process.join(10)
    assert command.rstrip(b"\0") == b"vaoi-worker-1"
    assert comm == "vaoi-worker-1\n"
    assert process.exitcode == 0


KEEP = """
from pathlib import Path
from vaoi_station.runs.host.process_title import set_process_title
before = Path("/proc/self/cmdline").read_bytes()
set_process_title("a title that is longer than any argument of this process " * 100, arguments=False)
assert Path("/proc/self/cmdline").read_bytes() == before
set_process_title("x" * 100_000, arguments=True)
shown = Path("/proc/self/cmdline").read_bytes()
assert shown == b"x" * (len(before) - 1) + b"\\0", shown
print(Path("/proc/self/comm").read_text())
"""


def test_a_long_title_is_cut_and_nothing_behind_it_is_overwritten() -> None:
    done = subprocess.run([sys.executable, "-c", KEEP], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.strip() == "x" * 15
    assert "PATH" in os.environ
