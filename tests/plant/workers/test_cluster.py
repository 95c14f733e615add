"""The cluster: its options, and a scheduler that does not answer."""

from __future__ import annotations

import socket

import pytest

from vaoi_station.errors import InputError, StateError
from vaoi_station.plant.workers.cluster import ClusterOptions, connection, dashboard_link


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
