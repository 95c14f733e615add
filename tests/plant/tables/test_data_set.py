"""Parquet files: complete, in parts, replaced as a whole, and the same for the same runs."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from vaoi_station import StitchedRun
from vaoi_station.plant.tables import TABLES, RunKey, Tables, arrow_schema, result_tables, write_tables


@pytest.fixture
def runs(stitched: StitchedRun) -> list[Tables]:
    made = []
    for n in range(3):
        key = RunKey("line 1", f"r{n}", f"2026-11-{n + 1:02d}T10:00:00Z", "small")
        made.append(result_tables(key, "new", stitched.result, stitched.board_type, stitched.recording.head))
    return made


def contents(directory: Path) -> dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in sorted(directory.rglob("*.parquet"))}


def test_what_is_written_is_read(runs: list[Tables], tmp_path: Path) -> None:
    write_tables(tmp_path / "tables", runs)
    for table in TABLES:
        read = pq.read_table(tmp_path / "tables" / table)
        assert read.schema.equals(arrow_schema(table), check_metadata=False)
        written = [value for tables in runs for value in tables[table]["run"]]
        assert read["run"].to_pylist() == written
    views = pq.read_table(tmp_path / "tables" / "views")
    assert views["x_px"].to_pylist() == [x for tables in runs for x in tables["views"]["x_px"]], "no digit is lost"
    assert str(views["time"][0]) == "2026-11-01 10:00:00+00:00"


def test_parts_are_bounded_and_equal_runs_give_equal_bytes(runs: list[Tables], tmp_path: Path) -> None:
    write_tables(tmp_path / "a", iter(runs), most_rows=1)
    write_tables(tmp_path / "b", iter(runs), most_rows=1)
    assert len(list((tmp_path / "a" / "runs").iterdir())) == 3
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_a_failure_keeps_the_older_data_set(runs: list[Tables], tmp_path: Path) -> None:
    def failing() -> Iterator[Tables]:
        yield runs[0]
        raise OSError("no space")

    write_tables(tmp_path / "tables", runs)
    before = contents(tmp_path / "tables")
    with pytest.raises(OSError, match="no space"):
        write_tables(tmp_path / "tables", failing(), most_rows=1)
    assert contents(tmp_path / "tables") == before
    write_tables(tmp_path / "tables", [])
    assert pq.read_table(tmp_path / "tables" / "runs").num_rows == 0, "readers find every table"
    assert [p.name for p in tmp_path.iterdir()] == ["tables"]


_KILLED = """
import os, signal, sys
from pathlib import Path
from vaoi_station.plant.tables import write_tables
write_tables(Path(sys.argv[1]), (os.kill(os.getpid(), signal.SIGKILL) for _ in range(1)))
"""


def test_what_a_killed_call_leaves_is_removed_by_the_next(tmp_path: Path) -> None:
    killed = subprocess.run([sys.executable, "-c", _KILLED, str(tmp_path / "tables")], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1, "the draft"
    write_tables(tmp_path / "tables", [])
    assert [p.name for p in tmp_path.iterdir()] == ["tables"]
