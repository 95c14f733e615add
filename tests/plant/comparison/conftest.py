"""A data set of runs that were stitched again with a calibration that is wrong by 0.2 px in one camera."""

from __future__ import annotations

from pathlib import Path

import pytest

import vaoi_station as vaoi
from vaoi_station import RecordedRun, StitchedRun
from vaoi_station.plant.comparison import Changes, compare
from vaoi_station.plant.tables import RunKey, Tables, result_tables, write_tables


@pytest.fixture(scope="session")
def changes(
    board: RecordedRun, stitched: StitchedRun, moved_calibration: Path, tmp_path_factory: pytest.TempPathFactory
) -> Changes:
    again = vaoi.open_recording(board.directory, calibration=moved_calibration).stitch()
    runs: list[Tables] = []
    for n in range(3):
        key = RunKey("line 1", f"r{n}", f"2026-11-{n + 1:02d}T10:00:00Z", "small", f"B{n}")
        results = (("former", stitched.result), ("new", again.result if n else stitched.result))
        # The last run has no former result.
        for name, result in results[n == 2 :]:
            runs.append(result_tables(key, name, result, board.board_type, stitched.recording.head))  # type: ignore[arg-type]
    tables = tmp_path_factory.mktemp("compared") / "tables"
    write_tables(tables, runs)
    return compare(tables)
