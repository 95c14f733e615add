"""The cluster: its options, a scheduler that does not answer, and workers with other software."""

from __future__ import annotations

import socket
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.errors import InputError, StateError
from vaoi_station.plant.restitch.cluster import ClusterOptions, Crew, connection
from vaoi_station.plant.restitch.software import software


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (ClusterOptions(), "one of them is needed"),
        (ClusterOptions(scheduler="tcp://h:1", workers=1), "exclude each other"),
        (ClusterOptions(workers=0), "--workers is 0, but must be from 1 to 256"),
        (ClusterOptions(scheduler="h:1"), "--scheduler is 'h:1', but must be an address"),
    ],
)
def test_options_are_checked(options: ClusterOptions, text: str) -> None:
    with pytest.raises(InputError, match=text):
        options.check()


def test_the_wait_for_a_scheduler_is_bounded() -> None:
    # A socket that listens and never replies: no other process gets the port while the test runs.
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(StateError, match=r"no scheduler answers within 0\.5 s"), connection(address, 0.5):
            pass


def test_workers_with_other_software_are_named_and_not_used(cluster: ClusterOptions) -> None:
    assert cluster.scheduler is not None
    reported: list[str] = []
    with connection(cluster.scheduler, cluster.patience_s) as client:
        workers = set(client.scheduler_info()["workers"])
        other = Crew(client, "vaoi_station 0.0.1", reported.append)
        other.update()
        other.update()
        assert not other.admitted
        assert len(reported) == len(workers), "each is reported once"
        assert f"it has {software()}, but must have vaoi_station 0.0.1." in reported[0]
        same = Crew(client, software(), reported.append)
        same.update()
        assert same.admitted == workers
        assert not same.refused
        assert same.resource != other.resource


def test_a_worker_that_is_started_again_under_its_address_is_asked_again() -> None:
    address, stated = "tcp://10.0.0.7:4000", "vaoi_station 2"
    process = {"local_directory": "/scratch/worker-a"}
    has, asked, reported = "vaoi_station 1", list[str](), list[str]()

    def run(*_: object, workers: list[str], on_error: str) -> dict[str, str]:
        asked.append(process["local_directory"][-1])
        return dict.fromkeys(workers, has)

    client: Any = SimpleNamespace(scheduler_info=lambda: {"workers": {address: process}}, run=run)
    crew = Crew(client, stated, reported.append)
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
