"""Results of stitching: the JSON of `formats.md`, also what `runs/{id}/matrices` answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.model import Stitch


def read_stitch(path: Path) -> Stitch:
    """Read a result."""
    data = read_json(path)
    check_format(data, path, "vaoi-stitch", 1)
    return parse(Stitch, data, path)


def stitch_document(stitch: Stitch) -> dict[str, Any]:
    """The JSON object of a result; null matrices stay, unused options go."""
    document = stitch.model_dump(mode="json")
    for key in ("surface", "components"):
        if document[key] is None:
            del document[key]
    return document


def write_stitch(path: Path, stitch: Stitch) -> None:
    """Write a result whole or not at all."""
    write_json(path, stitch_document(stitch))
