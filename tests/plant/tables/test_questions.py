"""The questions of docs/plant.md, verbatim, on a data set in which the answers are known."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import duckdb
import pytest

from vaoi_station import StitchedRun
from vaoi_station.plant.tables import RunKey, Tables, result_tables, write_tables

DOCUMENT = Path(__file__).parents[3] / "docs" / "plant.md"
QUESTIONS = re.findall(r"\n([^\n]+):\n\n```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
DAYS = 6


@pytest.fixture(scope="module")
def data_set(stitched: StitchedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six days with one run each: a seam that opens, R2 that drifts, U1 that is lifted on the last day."""
    folder = tmp_path_factory.mktemp("questions")

    def of_day(n: int) -> Tables:
        key = RunKey("line 1", f"r{n}", f"2026-11-{n + 1:02d}T10:00:00Z", "small")
        tables = result_tables(key, "new", stitched.result, stitched.board_type, stitched.recording.head)
        seams = tables["seams"]
        seams["camera"][0], seams["other_camera"][0], seams["residual_px"][0] = 3, 4, 0.01 * n
        components = tables["components"]
        components["x_mm"][components["component"].index("R2")] += 0.002 * n
        if n == DAYS - 1:
            components["height_mm"][components["component"].index("U1")] += 0.5
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
    ((board_type, component, runs, x, y),) = ask("place drifted")
    assert (board_type, component, runs) == ("small", "R2", DAYS)
    assert (x, y) == (pytest.approx(2.0, abs=0.1), pytest.approx(0, abs=0.05))
    assert ask("reasons") == [("light-dark", 0, 1)]
    assert {(camera, len(str(week)[:10])) for _, camera, week, _, _ in ask("each camera has moved")} == {
        (0, 10), (1, 10), (2, 10),
    }  # fmt: skip
    assert [row[1:3] for row in ask("stand higher")] == [(f"r{DAYS - 1}", "U1")]
    assert len(QUESTIONS) == 5, "a new question needs its answer here"
