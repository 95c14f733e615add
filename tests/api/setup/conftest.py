"""A service with the files by which its station is set up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from vaoi_station.api import create_app
from vaoi_station.api.setup.station_files import StationFiles


@pytest.fixture
def files(tmp_path: Path) -> StationFiles:
    return setup_files(tmp_path)


@pytest.fixture
def client(station: HeldStation, files: StationFiles) -> Iterator[TestClient]:
    app = create_app(station, ["testserver"], files=files)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client
