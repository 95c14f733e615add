"""A service with the files by which its station is set up."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from vaoi_station.api.app import create_app
from vaoi_station.api.setup.station_files import StationFiles

OTHER_USER = 65534


@pytest.fixture
def files(request: pytest.FixtureRequest, tmp_path: Path) -> StationFiles:
    """The files; the parameter: whether station.toml states the nominal views of the cameras."""
    return setup_files(tmp_path, getattr(request, "param", True))


@pytest.fixture
def client(station: HeldStation, files: StationFiles) -> Iterator[TestClient]:
    app = create_app(station, ["testserver"], files=files)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def protected(files: StationFiles) -> Iterator[StationFiles]:
    """The files in a folder that this process may read and not write, as the unit protects /etc."""
    folder = Path(tempfile.mkdtemp())
    try:
        path = folder / "station.toml"
        path.write_bytes(files.path.read_bytes())
        folder.chmod(0o555)
        if os.geteuid() == 0:
            os.seteuid(OTHER_USER)
        yield StationFiles(path, files.config)
    finally:
        if os.getuid() == 0:
            os.seteuid(0)
        folder.chmod(0o755)
        shutil.rmtree(folder)
