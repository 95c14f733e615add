"""An archive for data sets: boards with a place that is not fitted, and one run that is not ok."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.plant.conftest import add_runs
from vaoi_station import RecordedRun
from vaoi_station.plant.archive import Archive, RunLabel


@pytest.fixture(scope="session")
def boards(board: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """Return an archive of r0 … r3 of boards B0 … B3, in which R1 is not fitted, and of `bad`, which is degraded."""
    folder = tmp_path_factory.mktemp("boards")
    recording = Path(shutil.copytree(board.directory, folder / "run"))
    document = json.loads((recording / "board.json").read_text(encoding="utf-8"))
    for part in document["components"]:
        part["package"] = "0402" if part["ref"].startswith("R") else f"P {part['ref'][0]}"
        if part["ref"] == "R1":
            part["fitted"] = False
    (recording / "board.json").write_text(json.dumps(document), encoding="utf-8")
    archive = Archive.create(folder / "archive")
    add_runs(archive, recording, 4)
    result = json.loads((recording / "result.json").read_text(encoding="utf-8"))
    result |= {"status": "degraded", "reasons": ["dim"], "reason_codes": ["light-dark"]}
    (recording / "result.json").write_text(json.dumps(result), encoding="utf-8")
    archive.add(recording, station="line 9", label=RunLabel(run="bad", time="2026-11-09T10:00:00Z"))
    return archive
