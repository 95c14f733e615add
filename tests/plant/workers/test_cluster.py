"""The cluster: its options, and a scheduler that does not answer."""

from __future__ import annotations

import os
import signal
import socket
import time
from typing import Any

import dask
import pytest

from vaoi_station.errors import InputError, StateError
from vaoi_station.plant.workers.cluster import ClusterOptions, cluster_address, connection, dashboard_link


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


def test_the_link_to_the_dashboard_is_that_of_the_port_that_dask_got(cluster: ClusterOptions) -> None:
    assert cluster.scheduler is not None
    link = dashboard_link(cluster.scheduler, cluster.patience_s)
    with connection(cluster.scheduler, cluster.patience_s) as client:
        assert link == client.dashboard_link


def test_waiting_processes_of_the_local_cluster_wake_up_rarely(cluster: ClusterOptions) -> None:
    """Dask's own intervals have each event loop wake up more than 60 times a second, which runs pay for."""

    def wakes_hz(dask_worker: Any = None, dask_scheduler: Any = None) -> float:
        callbacks = (dask_worker or dask_scheduler).periodic_callbacks.values()
        return sum(1000.0 / float(callback.callback_time) for callback in callbacks)

    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        client.wait_for_workers(2, timeout=120)
        workers = client.run(wakes_hz)
        nannies = client.run(wakes_hz, nanny=True)
        scheduler = client.run_on_scheduler(wakes_hz)
    assert max(*workers.values(), *nannies.values()) < 10
    assert scheduler < 15


def test_a_worker_that_is_slow_to_come_back_after_its_end_is_not_given_up() -> None:
    """Dask closes the nanny of a worker that is absent for a time after its end; then no worker is left for ever."""
    # The successor takes seconds to start, so that with Dask's own setting it would be given up here.
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}),
        cluster_address(ClusterOptions(workers=1)) as address,
        connection(address, 30) as client,
    ):
        client.wait_for_workers(1, timeout=60)
        (process,) = client.run(os.getpid).values()
        os.kill(process, signal.SIGKILL)
        while client.scheduler_info()["workers"]:
            pass
        client.wait_for_workers(1, timeout=60)
        # It would be closed as soon as it is there.
        client.submit(time.sleep, 1.0).result(timeout=20)
        assert process not in client.run(os.getpid).values()
