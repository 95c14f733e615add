"""An archive of one run, of noise."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.conftest import recording
from vaoi_station.plant.archive import Archive, RunLabel

__all__ = ["archive", "recording"]


@pytest.fixture
def archive(recording: Path, tmp_path: Path) -> Archive:
    made = Archive.create(tmp_path / "archive")
    made.add(recording, station="line 1", label=RunLabel(run="r1", time="2026-11-01T10:00:00Z"))
    return made
