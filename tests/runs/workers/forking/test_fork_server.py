"""The fork server, in a real process: what a worker that it forks has, and what it must not have."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runs.workers.conftest import RingBoard
from tests.runs.workers.forking.served import PATIENCE_S, Served, few_files
from vaoi_station.benchmarks.process_usage import cpu_s
from vaoi_station.runs.workers.jobs import CloseRun, WorkerReady


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with Served() as made:
        yield made


@pytest.fixture
def ring(ring_board: RingBoard) -> str:
    return str(ring_board.ring.path)


def open_files(pid: int) -> set[str]:
    """Return what a process has open, but for the null device and the test's output."""
    links = (str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir())
    return {link for link in links if link.startswith(("socket:", "anon_inode:"))}


def test_two_workers_perform_jobs_at_the_same_time(served: Served, ring: str, ring_board: RingBoard) -> None:
    workers = [served.started(ring, index) for index in (0, 1)]
    for process, pipe in workers:
        assert pipe.recv() == WorkerReady(process.pid)
        for message in (ring_board.opening, ring_board.link(*ring_board.tasks), CloseRun("r1")):
            pipe.send(message)
    links = [pipe.recv() for _, pipe in workers]
    assert [len(found.value) for found in links] == 2 * [len(ring_board.tasks)]
    for _, pipe in workers:
        pipe.close()
    assert [served.code(process) for process, _ in workers] == [0, 0], "a worker ends with its pipe"


def test_a_worker_starts_without_imports_and_compiler(served: Served, ring: str) -> None:
    process, pipe = served.started(ring)
    assert isinstance(pipe.recv(), WorkerReady)
    assert cpu_s(process.pid) < 0.3, "a start by itself takes seconds"
    pipe.close()
    served.code(process)


def test_a_worker_has_its_name_and_one_thread_and_nothing_of_the_server(served: Served, ring: str) -> None:
    first, its_pipe = served.started(ring, 3)
    second, pipe = served.started(ring, 4)
    pipe.recv()
    folder = Path(f"/proc/{second.pid}")
    assert (folder / "comm").read_text() == "vaoi-worker-4\n"
    assert (folder / "cmdline").read_bytes().rstrip(b"\0") == b"vaoi-worker-4"
    assert len(list((folder / "task").iterdir())) == 1
    assert not open_files(second.pid) & open_files(served.pid)
    assert len(open_files(second.pid)) == 1, "its pipe alone"
    for end in (its_pipe, pipe):
        end.close()
    assert (served.code(first), served.code(second)) == (0, 0)
    assert Path(f"/proc/{served.pid}/comm").read_text() == "vaoi-forkserver\n"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGABRT])
def test_the_signal_that_ended_a_worker_is_its_exit_code(served: Served, ring: str, number: signal.Signals) -> None:
    process, pipe = served.started(ring)
    os.kill(process.pid, number)
    assert served.code(process) == -number
    pipe.close()
    assert not Path(f"/proc/{process.pid}").exists(), "the fork server has reaped it"


def test_a_worker_that_cannot_open_the_ring_has_an_exit_code(served: Served, tmp_path: Path) -> None:
    process, pipe = served.started(str(tmp_path / "absent.ring"))
    assert served.code(process) == 1
    pipe.close()


def test_a_worker_that_cannot_be_forked_is_reported(served: Served, ring: str) -> None:
    """The limits are those of the server: it has no room for the worker's pipe, and then for nothing else."""
    for room, why in ((0, "the fork server has too many open files"), (1, "Too many open files")):
        with few_files(served.pid, room):
            outcome, pipe = served.requested(ring)
        assert why in str(outcome)
        with pytest.raises(EOFError):
            pipe.recv()
        pipe.close()
    process, pipe = served.started(ring)
    pipe.close()
    assert served.code(process) == 0


def test_workers_go_on_when_the_server_dies_and_end_with_their_pipes(ring: str, ring_board: RingBoard) -> None:
    with Served() as served:
        process, pipe = served.started(ring)
        pipe.recv()
        victim = served.pid
        os.kill(victim, signal.SIGKILL)
        served.until(lambda: bool(served.reports))
        assert served.reports == ["The fork server ended with code -9; it is restarted. Workers that run go on."]
        assert not served.link.will_report(process), "its exit code stays unknown"
        pipe.send(ring_board.opening)
        pipe.send(ring_board.link(ring_board.tasks[0]))
        assert pipe.recv().error is None
        served.until(lambda: served.link.ready)
        assert served.pid != victim
        assert served.link.status().restarts == 1
        pipe.close()
        assert process.has_ended(PATIENCE_S)
        assert process.exit_code is None
