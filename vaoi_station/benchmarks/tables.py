"""Figures as JSON and as Markdown tables; one that is absent is null, or a dash."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def json_document(value: Any) -> Any:
    """Return a copy of nested dictionaries, lists and tuples in which NaN and infinity, which JSON lacks, are None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: json_document(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_document(entry) for entry in value]
    return value


def number(value: float | None, decimals: int) -> str:
    """Format a figure for a table; a dash if it is absent."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])
