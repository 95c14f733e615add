"""The adder waits for its turns, and says whether run or archive are at fault."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from multiprocessing import Pipe
from pathlib import Path

from vaoi_station.runs.handover.adder import Addition, Failed, Turn, serve

ROOT = Path(__file__).parents[3]
STATION = """
from pathlib import Path
from vaoi_station.board_data.import_process import ImportTask
from vaoi_station.board_data.import_process import import_limited
from vaoi_station.errors import InputError
from vaoi_station.runs.handover.adder import Addition, launch_adder
pipe, process = launch_adder()
pipe.send(Addition("absent", Path("absent"), "one"))
print(pipe.recv().error.message)
pipe.close()
process.wait()
try:
    import_limited(ImportTask(file="absent.csv"))
except InputError as error:
    print(error.message)
"""


def outcome(wanted: Addition) -> tuple[object, int]:
    """Return how an addition ended, and the number of turns that it took."""
    ours, its = Pipe()
    thread = threading.Thread(target=serve, args=(its,))
    thread.start()
    ours.send(wanted)
    turns = 0
    while isinstance(reply := ours.recv(), Turn):
        ours.send(True)
        turns += 1
    ours.close()
    thread.join()
    return reply, turns


def test_an_absent_archive_is_not_the_fault_of_the_run(tmp_path: Path) -> None:
    failed, turns = outcome(Addition(str(tmp_path / "archive"), tmp_path, "one"))
    assert isinstance(failed, Failed)
    assert (failed.of_run, turns) == (False, 0)
    assert "is no archive" in failed.error.message


def test_the_processes_of_a_source_checkout_run_its_own_code(tmp_path: Path) -> None:
    """Another version that is installed, which their `-P` would find instead, cannot even be imported here."""
    (tmp_path / "vaoi_station").mkdir()
    (tmp_path / "vaoi_station" / "__init__.py").write_text("raise ImportError('This is another version.')\n")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", STATION], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    added, imported = done.stdout.splitlines()
    assert "absent: is no archive" in added
    assert "absent.csv: cannot be read: No such file or directory" in imported
