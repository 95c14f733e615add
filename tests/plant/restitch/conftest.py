"""A local cluster of two worker processes over TCP, shared by the session, and what a call writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.restitch import ClusterOptions, Session, Terms
from vaoi_station.plant.restitch.cluster import cluster_address
from vaoi_station.plant.restitch.software import software


@pytest.fixture(scope="session")
def cluster() -> Iterator[ClusterOptions]:
    """Return the options by which a call uses the session's cluster."""
    with cluster_address(ClusterOptions(workers=2)) as address:
        yield ClusterOptions(scheduler=address, patience_s=120)


@pytest.fixture
def session(stored: Archive, tmp_path: Path) -> Callable[..., Session]:
    """Make what a call works on: by default the archive of four runs."""

    def make(*archives: Archive, terms: Terms | None = None, selection: RunSelection | None = None) -> Session:
        urls = [archive.url for archive in archives or (stored,)]
        return Session(urls, selection or RunSelection(), terms or Terms(software()), tmp_path / "out")

    return make
