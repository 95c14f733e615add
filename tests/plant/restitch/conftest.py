"""What a call of `vaoi restitch` works on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.restitch import Session, Terms
from vaoi_station.plant.workers.software import software


@pytest.fixture
def session(stored: Archive, tmp_path: Path) -> Callable[..., Session]:
    """Make what a call works on: by default the archive of four runs."""

    def make(*archives: Archive, terms: Terms | None = None, selection: RunSelection | None = None) -> Session:
        urls = [archive.url for archive in archives or (stored,)]
        return Session(urls, selection or RunSelection(), terms or Terms(software()), tmp_path / "out")

    return make
