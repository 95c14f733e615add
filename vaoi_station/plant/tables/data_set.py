"""Write tables as Parquet files, in parts of bounded size."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from glob import escape
from pathlib import Path
from typing import Any

from vaoi_station.files.atomic_directory import new_directory, remove_directory
from vaoi_station.plant.tables.extraction import Tables
from vaoi_station.plant.tables.schema import TABLES, arrow_schema

MOST_ROWS = 500_000
"""Number of rows of all tables together from which a part is written: it bounds the memory of the writer."""


def write_tables(directory: Path, runs: Iterable[Tables], most_rows: int = MOST_ROWS) -> None:
    """Write the tables of runs to `directory/TABLE/part-NNNNN.parquet`, and replace an older data set.

    Equal runs in equal order give equal bytes. The tables of all runs are never in memory together.
    """
    draft_of = directory.with_name(f".{directory.name}.new")
    for left in (draft_of, *directory.parent.glob(f".{escape(draft_of.name)}.*")):
        shutil.rmtree(left, ignore_errors=True)  # of a call that was killed
    with new_directory(draft_of) as draft:
        for table in TABLES:
            (draft / table).mkdir()
        part, rows = 0, _empty()
        for tables in runs:
            for table, columns in tables.items():
                for column, values in columns.items():
                    rows[table][column] += values
            if sum(len(rows[table]["run"]) for table in TABLES) >= most_rows:
                _write_part(draft, part, rows)
                part, rows = part + 1, _empty()
        # The first part is written even without rows: readers find every table, with its columns.
        if part == 0 or rows["runs"]["run"]:
            _write_part(draft, part, rows)
    if directory.exists():
        remove_directory(directory)
    draft_of.rename(directory)


def _empty() -> Tables:
    return {table: {column.name: [] for column in columns} for table, columns in TABLES.items()}


def _write_part(directory: Path, part: int, rows: Tables) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    for table in TABLES:
        columns = {name: _times(values) if name == "time" else values for name, values in rows[table].items()}
        path = directory / table / f"part-{part:05d}.parquet"
        pq.write_table(pa.table(columns, schema=arrow_schema(table)), path, compression="zstd")


def _times(values: list[Any]) -> list[Any]:
    """Convert RFC 3339 texts; rows of one run have equal ones."""
    from datetime import datetime

    known = {text: datetime.fromisoformat(text) for text in set(values)}
    return [known[text] for text in values]
