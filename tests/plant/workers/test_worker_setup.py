"""Ctrl-C ends the command, and not its workers one by one."""

from __future__ import annotations

import signal

from vaoi_station.plant.workers.cluster import ClusterOptions, connection


def test_workers_of_this_machine_ignore_the_key(cluster: ClusterOptions) -> None:
    assert cluster.scheduler is not None
    with connection(cluster.scheduler, cluster.patience_s) as client:
        handlers = client.run(signal.getsignal, signal.SIGINT)
    assert set(handlers.values()) == {signal.SIG_IGN}
