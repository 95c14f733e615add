"""The work on many runs: a killed worker costs one run's work, and an absent cluster a bounded wait."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from distributed import LocalCluster

from tests.plant.conftest import add_runs, task_of
from vaoi_station import RecordedRun
from vaoi_station.errors import StateError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.restitch import ClusterOptions, Terms
from vaoi_station.plant.restitch.cluster import connection
from vaoi_station.plant.restitch.dispatch import Dispatch
from vaoi_station.plant.restitch.software import software
from vaoi_station.plant.restitch.task import RunTask, read_outcome


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

    dispatch = Dispatch(software(), keep, faults.append, lambda _: None)
    dispatch.work(cluster.scheduler, tasks, cluster.patience_s)
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
        Dispatch(software(), keep, pytest.fail, report).work(address, tasks, 120)
    finally:
        running[-1].close()
    assert sorted(t.key for t in kept) == sorted(t.key for t in tasks)
    assert "the scheduler has gone; 3 runs are given to the next." in reported[0]


def test_a_run_that_cannot_be_stitched_does_not_stop_the_others(
    stored: Archive, cluster: ClusterOptions, tmp_path: Path
) -> None:
    good, other = (task_of(stored, run.run) for run in list(stored.runs())[:2])
    absent = replace(good, key=good.key.replace("r0", "r9"))
    kept: list[RunTask] = []
    faults: list[str] = []
    assert cluster.scheduler is not None
    Dispatch(software(), lambda task, _: kept.append(task), faults.append, lambda _: None).work(
        cluster.scheduler, [absent, good, other], cluster.patience_s
    )
    assert {t.key for t in kept} == {good.key, other.key}
    assert len(faults) == 1
    assert "r9.json" in faults[0]


def test_without_a_usable_worker_the_wait_is_bounded(stored: Archive, cluster: ClusterOptions) -> None:
    task = task_of(stored, "r0", Terms("vaoi_station 0.0.1"))
    dispatch = Dispatch("vaoi_station 0.0.1", lambda *_: None, lambda _: None, lambda _: None)
    assert cluster.scheduler is not None
    with pytest.raises(StateError, match=r"No usable worker for 0\.2 s; 1 runs are left\. worker tcp://"):
        dispatch.work(cluster.scheduler, [task], cluster.patience_s, workers_patience_s=0.2)
    assert len(dispatch.refused_workers) == 2
