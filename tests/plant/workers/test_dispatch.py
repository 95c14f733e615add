"""The work on many runs: a killed worker costs one run's work, and an absent cluster a bounded wait."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from distributed import Future, LocalCluster, get_worker

from tests.plant.conftest import add_runs, task_of
from vaoi_station import RecordedRun
from vaoi_station.errors import StateError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.restitch import ClusterOptions, Terms
from vaoi_station.plant.restitch.task import RunTask, read_outcome, restitch_run
from vaoi_station.plant.workers.cluster import cluster_address, connection
from vaoi_station.plant.workers.dispatch import AHEAD, Dispatch
from vaoi_station.plant.workers.run_work import UnseenArchive
from vaoi_station.plant.workers.software import software


def refuse(task: RunTask, text: str) -> None:
    """Fail: no run may be left out."""
    pytest.fail(f"{task.key}: {text}")


def note(faults: list[str]) -> Callable[[RunTask, str], None]:
    """Return a function that notes why a run is left out."""
    return lambda _task, text: faults.append(text)


def test_a_killed_worker_costs_no_run(board: RecordedRun, cluster: ClusterOptions, tmp_path: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 12)
    tasks = [task_of(archive, run.run) for run in archive.runs()]
    assert cluster.scheduler is not None
    kept: list[RunTask] = []
    faults: list[str] = []
    processes: list[int] = []

    def keep(task: RunTask, content: bytes) -> None:
        kept.append(task)
        (tmp_path / "run").write_bytes(content)
        process = read_outcome(tmp_path / "run")["cost"]["process"]
        if not processes:
            os.kill(process, signal.SIGKILL)
        processes.append(process)

    dispatch = Dispatch(software(), restitch_run, keep, note(faults), lambda _: None)
    dispatch.work(cluster.scheduler, tasks, [tasks[0].archive], cluster.patience_s)
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks), "no run is lost, and none comes twice"
    assert not faults
    with connection(cluster.scheduler, cluster.patience_s) as client:
        client.wait_for_workers(2, timeout=120)  # the nanny has started it again
        assert processes[0] not in client.run(os.getpid).values()


def test_runs_are_taken_when_workers_are_to_have_them(stored: Archive, cluster: ClusterOptions) -> None:
    tasks = [task_of(stored, "r0")] * 9
    kept: list[RunTask] = []
    ahead: list[int] = []

    def taken() -> Iterator[RunTask]:
        for n, task in enumerate(tasks):
            ahead.append(n - len(kept))
            yield task

    assert cluster.scheduler is not None
    dispatch = Dispatch(software(), restitch_run, lambda task, _: kept.append(task), refuse, lambda _: None)
    dispatch.work(cluster.scheduler, taken(), [stored.url], cluster.patience_s)
    assert len(kept) == len(tasks)
    assert max(ahead) <= AHEAD * 2, "for two workers"


def test_a_scheduler_that_is_restarted_goes_on_with_what_is_not_done(stored: Archive) -> None:
    def start(port: int) -> LocalCluster:
        return LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            host="127.0.0.1",
            protocol="tcp://",
            scheduler_port=port,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            silence_logs=50,
        )

    tasks = [task_of(stored, run.run) for run in stored.runs()]
    kept: list[RunTask] = []
    reported: list[str] = []
    running = [start(0)]
    address = running[0].scheduler_address

    def keep(task: RunTask, _: bytes) -> None:
        kept.append(task)
        if len(kept) == 1:
            running[0].close()

    def report(text: str) -> None:
        reported.append(text)
        running.append(start(int(address.rpartition(":")[2])))

    try:
        Dispatch(software(), restitch_run, keep, refuse, report).work(address, tasks, [stored.url], 120)
    finally:
        running[-1].close()
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)
    assert "the scheduler has gone; what is not done is given to the next." in reported[0]


def test_a_run_that_cannot_be_stitched_does_not_stop_the_others(
    stored: Archive, cluster: ClusterOptions, tmp_path: Path
) -> None:
    good, other = (task_of(stored, run.run) for run in list(stored.runs())[:2])
    absent = replace(good, key=good.key.replace("r0", "r9"))
    kept: list[RunTask] = []
    faults: list[str] = []
    assert cluster.scheduler is not None
    Dispatch(software(), restitch_run, lambda task, _: kept.append(task), note(faults), lambda _: None).work(
        cluster.scheduler, [absent, good, other], [stored.url], cluster.patience_s
    )
    assert {t.key for t in kept} == {good.key, other.key}
    assert len(faults) == 1
    assert "r9.json" in faults[0]


def test_without_a_usable_worker_the_wait_is_bounded(stored: Archive, cluster: ClusterOptions) -> None:
    task = task_of(stored, "r0", Terms("vaoi_station 0.0.1"))
    dispatch = Dispatch("vaoi_station 0.0.1", restitch_run, lambda *_: None, refuse, lambda _: None)
    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        client.wait_for_workers(2, timeout=120)  # The test before may have killed one.
        client.run(software)  # The first time takes long on a busy machine.
    with pytest.raises(StateError, match=r"No usable worker for 0\.2 s; runs are left\. worker tcp://"):
        dispatch.work(cluster.scheduler, [task], [stored.url], cluster.patience_s, workers_patience_s=0.2)
    assert len(dispatch.refused_workers) == 2


@contextmanager
def mounted(cluster: ClusterOptions, archive: Path, machines: Path) -> Iterator[str]:
    """Give each worker a mount point of its own, to which the relative path `share` of the archive leads."""
    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        client.wait_for_workers(2, timeout=120)  # The test before may have killed one.
        before = client.run(os.getcwd)
        client.run(software)  # The first time takes long on a busy machine.
        for n, address in enumerate(before):
            (machines / f"machine{n}").mkdir()
            (machines / f"machine{n}" / "share").symlink_to(archive)
            client.run(os.chdir, str(machines / f"machine{n}"), workers=[address])
        try:
            yield cluster.scheduler
        finally:
            for address, folder in before.items():
                client.run(os.chdir, folder, workers=[address])


def test_runs_that_wait_at_a_worker_without_its_share_are_given_to_another(
    board: RecordedRun, cluster: ClusterOptions, tmp_path: Path
) -> None:
    """A worker never begins a run that it was given before it lost the resource, and Dask leaves it there."""
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 6)
    tasks = [replace(task_of(archive, run.run), archive="share") for run in archive.runs()]
    marker, kept = tmp_path / "lost", list[RunTask]()

    def lose_share(_: RunTask) -> bytes | UnseenArchive:
        try:
            marker.mkdir()
        except FileExistsError:
            return b"done"
        worker: Any = get_worker()
        while len(worker.state.tasks) < AHEAD:
            threading.Event().wait(0.02)
        (name,) = (name for name in worker.state.total_resources if name.startswith("vaoi-"))
        taken = worker.set_resources(**{name: 0})
        asyncio.run_coroutine_threadsafe(taken, worker.loop.asyncio_loop).result(30)
        Path("share").unlink()
        return UnseenArchive("the share is gone", worker.address)

    with mounted(cluster, tmp_path / "archive", tmp_path) as address:
        dispatch = Dispatch(software(), lose_share, lambda task, _: kept.append(task), refuse, lambda _: None)
        dispatch.work(address, tasks, ["share"], cluster.patience_s)
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)
    assert len(dispatch.refused_workers) == 1


def test_a_worker_that_loses_its_share_costs_no_run(
    board: RecordedRun, cluster: ClusterOptions, tmp_path: Path
) -> None:
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 8)
    kept: list[RunTask] = []
    reported: list[str] = []
    tasks = [replace(task_of(archive, run.run), archive="share") for run in archive.runs()]

    def keep(task: RunTask, _: bytes) -> None:
        kept.append(task)
        (tmp_path / "machine1" / "share").unlink(missing_ok=True)

    with mounted(cluster, tmp_path / "archive", tmp_path) as address:
        dispatch = Dispatch(software(), restitch_run, keep, refuse, reported.append)
        dispatch.work(address, tasks, ["share"], cluster.patience_s)
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)
    assert len(dispatch.refused_workers) == 1
    assert "share: is no archive" in dispatch.refused_workers[0]


def test_a_worker_that_is_killed_before_its_outcome_is_fetched_costs_no_wait(
    stored: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = [task_of(stored, run.run) for run in stored.runs()]
    kept: list[RunTask] = []
    killed: list[int] = []
    result = Future.result

    def killing(future: Future[object], timeout: float | None = None) -> object:
        if not killed:
            killed.extend(future.client.run(os.getpid).values())
            os.kill(killed[0], signal.SIGKILL)
        return result(future, timeout=timeout)

    monkeypatch.setattr(Future, "result", killing)
    with cluster_address(ClusterOptions(workers=1)) as address:
        Dispatch(software(), restitch_run, lambda task, _: kept.append(task), refuse, pytest.fail).work(
            address, tasks, [stored.url], 120
        )
    assert len(killed) == 1
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks), "without another scheduler"


def test_the_only_worker_may_be_killed_in_mid_run(stored: Archive) -> None:
    tasks = [task_of(stored, run.run) for run in stored.runs()]
    kept: list[RunTask] = []

    with cluster_address(ClusterOptions(workers=1)) as address, connection(address, 120) as client:

        def keep(task: RunTask, _: bytes) -> None:
            kept.append(task)
            if len(kept) == 1:
                (process,) = client.run(os.getpid).values()
                os.kill(process, signal.SIGKILL)

        Dispatch(software(), restitch_run, keep, refuse, pytest.fail).work(address, tasks, [stored.url], 120)
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)
