"""Workers are admitted if they have the stated software and see the archives; each other one is named."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from vaoi_station.plant.archive import Archive
from vaoi_station.plant.workers.cluster import ClusterOptions, connection
from vaoi_station.plant.workers.crew import Crew, Reply
from vaoi_station.plant.workers.software import software


def until(crew: Crew, reached: Callable[[], bool]) -> None:
    """Update a crew until a state is reached: the first reply of a worker may take long on a busy machine."""
    deadline = time.monotonic() + 120
    while not reached():
        assert time.monotonic() < deadline
        crew.update()


def test_workers_with_other_software_are_named_and_not_used(cluster: ClusterOptions) -> None:
    assert cluster.scheduler is not None
    reported: list[str] = []
    with connection(cluster.scheduler, cluster.patience_s) as client:
        workers = set(client.scheduler_info()["workers"])
        other = Crew(client, "vaoi_station 0.0.1", (), reported.append)
        until(other, lambda: len(reported) == len(workers))
        other.update()
        assert not other.admitted
        assert len(reported) == len(workers), "each is reported once"
        assert f"it has {software()}, but must have vaoi_station 0.0.1." in reported[0]
        same = Crew(client, software(), (), reported.append)
        until(same, lambda: same.admitted == workers)
        assert not same.refused
        assert same.resource != other.resource


def test_a_worker_that_is_started_again_under_its_address_is_asked_again() -> None:
    address, stated = "tcp://10.0.0.7:4000", "vaoi_station 2"
    process = {"local_directory": "/scratch/worker-a"}
    has, asked, reported = "vaoi_station 1", list[str](), list[str]()

    def run(*_: object, workers: list[str], on_error: str) -> dict[str, Reply]:
        asked.append(process["local_directory"][-1])
        return dict.fromkeys(workers, Reply(has))

    client: Any = SimpleNamespace(scheduler_info=lambda: {"workers": {address: process}}, run=run)
    crew = Crew(client, stated, (), reported.append)
    crew.update()
    crew.update()
    assert (crew.admitted, asked, len(reported)) == (set(), ["a"], 1)
    process["local_directory"], has = "/scratch/worker-b", stated
    crew.update()
    assert crew.admitted == {address}, "it was updated"
    process["local_directory"] = "/scratch/worker-c"
    crew.update()
    crew.update()
    assert asked == ["a", "b", "c"], "each process gets the resource, also one that came back between two looks"
    assert crew.admitted == {address}


def test_a_worker_that_hangs_does_not_keep_the_others_from_being_admitted(cluster: ClusterOptions) -> None:
    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        processes = client.run(os.getpid)
        hanging, *others = processes
        os.kill(processes[hanging], signal.SIGSTOP)
        try:
            crew = Crew(client, software(), (), lambda _: None)
            until(crew, lambda: crew.admitted == {*others})
        finally:
            os.kill(processes[hanging], signal.SIGCONT)
        until(crew, lambda: crew.admitted == {*processes})
        assert not crew.refused


def test_a_worker_that_does_not_see_the_archive_is_named_until_it_does(cluster: ClusterOptions, tmp_path: Path) -> None:
    assert cluster.scheduler is not None
    reported: list[str] = []
    url = str(tmp_path / "archive")
    with connection(cluster.scheduler, cluster.patience_s) as client:
        crew = Crew(client, software(), [url], reported.append)
        until(crew, lambda: len(crew.refused) == len(client.scheduler_info()["workers"]))
        crew.update()
        assert len(reported) == len(crew.refused)
        assert f"it cannot read an archive: {url}: is no archive" in reported[0]
        Archive.create(url)
        until(crew, lambda: not crew.refused)
        assert crew.admitted == {*client.scheduler_info()["workers"]}
