"""Files that a station.toml names and that are not there, such as private keys after a backup was restored."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel


def absent_files(section: BaseModel, place: str = "") -> Iterator[tuple[str, Path]]:
    """Yield key and path of every file or directory that a configuration names and that does not exist."""
    for key in type(section).model_fields:
        value = getattr(section, key)
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Path) and not part.exists():
                yield f"{place}{key}", part
            elif isinstance(part, BaseModel):
                yield from absent_files(part, f"{place}{key}.")
