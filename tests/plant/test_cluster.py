"""Work on a Dask cluster, whose workers and scheduler end."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from distributed import LocalCluster

from tests.plant.conftest import add_runs, task_of
from vaoi_station import RecordedRun
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.cluster import (
    ClusterOptions,
    Dispatch,
    RunFault,
    WorkerFault,
    cluster_address,
    connection,
    perform,
    software,
)
from vaoi_station.plant.restitch import RunTask, Terms, read_outcome, restitch_run


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
    with pytest.raises(StateError, match=r"No usable worker for 2 s; runs are left\. worker tcp://"):
        dispatch.work(cluster.scheduler, [task], [stored.url], cluster.patience_s, workers_patience_s=2.0)
    assert len(dispatch.refused_workers) == 2
    assert f"it has {software()}, but must have vaoi_station 0.0.1." in dispatch.refused_workers[0]


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


def test_a_worker_that_hangs_does_not_keep_the_others_from_their_work(stored: Archive, cluster: ClusterOptions) -> None:
    tasks = [task_of(stored, run.run) for run in stored.runs()]
    kept: list[RunTask] = []
    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        client.wait_for_workers(2, timeout=120)
        hanging = min(client.run(os.getpid).values())
        os.kill(hanging, signal.SIGSTOP)
        try:
            dispatch = Dispatch(software(), restitch_run, lambda task, _: kept.append(task), refuse, lambda _: None)
            dispatch.work(cluster.scheduler, tasks, [stored.url], cluster.patience_s, workers_patience_s=120)
        finally:
            os.kill(hanging, signal.SIGCONT)
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)


def test_a_run_that_ends_its_worker_again_and_again_is_left_out(stored: Archive) -> None:
    tasks = [task_of(stored, run.run) for run in stored.runs()][:3]
    deadly, kept, faults = tasks[1].key, list[str](), list[str]()

    def die(task: RunTask) -> bytes:
        if task.key == deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return b"done"

    with cluster_address(ClusterOptions(workers=1)) as address:
        dispatch = Dispatch(software(), die, lambda task, _: kept.append(task.key), note(faults), lambda _: None)
        dispatch.work(address, tasks, [stored.url], 30, workers_patience_s=120)
    assert sorted(kept) == sorted([tasks[0].key, tasks[2].key]), "also if it was at the same worker"
    assert [deadly in fault and "its worker ended 4 times" in fault for fault in faults] == [True]


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


@pytest.mark.parametrize("kind", [InputError, StateError])
def test_a_fault_of_the_run_is_returned(stored: Archive, kind: type[InputError | StateError]) -> None:
    def work(*_: object) -> bytes:
        raise kind("it does not fit.")

    outcome = perform(task_of(stored, "r2"), work)
    assert isinstance(outcome, RunFault)
    assert "it does not fit." in outcome.message


def test_a_fault_of_the_storage_is_raised_so_that_it_is_tried_again(stored: Archive) -> None:
    def work(*_: object) -> bytes:
        raise DeviceError("it does not answer.")

    with pytest.raises(DeviceError, match="does not answer"):
        perform(task_of(stored, "r2"), work)


def test_an_archive_that_goes_during_the_work_is_no_fault_of_the_run(stored: Archive, tmp_path: Path) -> None:
    (tmp_path / "share").symlink_to(stored.url)
    moved = Archive.open(tmp_path / "share")

    def work(*_: object) -> bytes:
        (tmp_path / "share").unlink()
        raise InputError("a blob is absent.")

    outcome = perform(task_of(moved, "r2"), work)
    assert isinstance(outcome, WorkerFault)
    assert "is no archive" in outcome.message
