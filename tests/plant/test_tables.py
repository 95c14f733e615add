"""Results as Parquet tables."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.parquet as pq
import pytest

from vaoi_station import StitchedRun
from vaoi_station.plant.tables import TABLES, RunKey, Tables, arrow_schema, result_tables, write_tables

DOCUMENT = Path(__file__).parents[2] / "docs" / "plant.md"


KEY = RunKey("line 1", "r1", "2026-11-23T10:00:00Z", "small", "B1")


def test_every_figure_is_that_of_the_result(stitched: StitchedRun) -> None:
    result, head = stitched.result, stitched.recording.head
    tables = result_tables(KEY, "new", result, stitched.board_type, head)
    assert {len(values) for values in tables["runs"].values()} == {1}
    assert tables["runs"]["status"] == ["ok"]
    assert tables["runs"]["board_id"] == ["B1"]
    assert tables["runs"]["link_median_px"] == [result.quality["residual_px"]["median"]]
    assert tables["rows"]["row"] == list(range(head.rows))
    assert tables["rows"]["sigma_px"] == result.quality["row_sigma_px"]
    assert tables["rows"]["y_mm"][1] == pytest.approx(11.0, rel=0.05), "100 mm/s for 0.11 s"
    assert tables["seams"]["residual_px"] == list(result.quality["seams_px"].values())
    assert [[x, y] for x, y in zip(tables["cameras"]["x_px"], tables["cameras"]["y_px"], strict=True)] == [
        moved[:2] for moved in result.quality["camera_displacement_px"]
    ]
    assert tables["cameras"]["px_per_mm"] == pytest.approx([18.0] * 3, rel=0.02)
    assert tables["fiducials"]["name"] == [mark["name"] for mark in result.quality["fiducials"]]


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


QUESTIONS = re.findall(r"\n([^\n]+):\n\n```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
DAYS = 6


@pytest.fixture(scope="module")
def data_set(stitched: StitchedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six days with one run each: a seam that opens, and a reason on the last day."""
    folder = tmp_path_factory.mktemp("questions")

    def of_day(n: int) -> Tables:
        key = RunKey("line 1", f"r{n}", f"2026-11-{n + 1:02d}T10:00:00Z", "small")
        tables = result_tables(key, "new", stitched.result, stitched.board_type, stitched.recording.head)
        seams = tables["seams"]
        seams["camera"][0], seams["other_camera"][0], seams["residual_px"][0] = 3, 4, 0.01 * n
        if n == DAYS - 1:
            tables["runs"]["reason_codes"] = [["light-dark"]]
        return tables

    write_tables(folder / "tables", map(of_day, range(DAYS)))
    return folder


def ask(words: str) -> list[tuple[Any, ...]]:
    (query,) = [query for text, query in QUESTIONS if words in text]
    return duckdb.execute(query).fetchall()


def test_every_question_has_its_answer(data_set: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(data_set)
    seam = ask("seam between cameras 3 and 4 by day")
    assert [(str(day)[:10], runs, px) for _, day, runs, px in seam] == [
        (f"2026-11-{n + 1:02d}", 1, pytest.approx(0.01 * n)) for n in range(DAYS)
    ]
    assert ask("reasons") == [("light-dark", 0, 1)]
    assert len(QUESTIONS) == 2, "a new question needs its answer here"
