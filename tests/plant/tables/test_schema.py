"""The schema of the tables is what docs/plant.md says."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from vaoi_station.plant.tables import TABLES, arrow_schema

DOCUMENT = Path(__file__).parents[3] / "docs" / "plant.md"


@pytest.mark.parametrize("table", TABLES)
def test_the_document_lists_every_column(table: str) -> None:
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    for column in TABLES[table]:
        assert f"| `{table}` | `{column.name}` | {column.kind} | {column.meaning} |" in lines


def test_fields_carry_their_meaning() -> None:
    field = arrow_schema("seams").field("residual_px")
    assert field.type == pa.float64()
    assert field.metadata == {b"meaning": b"median residual of the links between both"}
