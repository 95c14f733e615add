"""Read and write results of stitching. `runs/{id}/matrices` replies in the same format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field
from pydantic_core import from_json

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.model import BoardType, Finite, Stitch
from vaoi_station.model.stitch_result import Heights

_OF_COMPONENTS = ("component_sigma_px", "component_covariance_px2", "heights_mm", "height_sigma_mm")
_LARGE = (*_OF_COMPONENTS, "link_pairs")
_LEFT_OUT_IF_NONE = ("surface", "components", "camera_matrices", "local_matrices", "board_matrices", "skipped_boards")


class _Height(BaseModel):
    """What is read of an entry of a document of heights."""

    height_mm: Annotated[Finite, Field(ge=-1000, le=1000)] | None = None
    sigma_mm: Annotated[Finite, Field(gt=0, le=1000)] | None = None


def read_stitch(path: Path) -> Stitch:
    """Read a result; raise InputError with file, key and value if it is invalid."""
    data = read_json(path)
    check_format(data, path, "vaoi-stitch", 1)
    return parse(Stitch, data, path)


def read_heights(path: Path, board_type: BoardType) -> Heights:
    """Read the heights that `vaoi heights` or a station measured; intervals are left out.

    Raises:
        InputError: the file is not such a document, or has a component that the board type does not have.
    """
    data = read_json(path)
    # A station's reply has them under one key.
    entries = data.get("heights", data) if isinstance(data, dict) else data
    if not isinstance(entries, dict):
        raise InputError(f"{path}: holds a {type(entries).__name__}, must be an object of heights by component.")
    found = {ref: parse(_Height, entry, f"{path}: {ref}") for ref, entry in entries.items()}
    for ref in found:
        if board_type.component(ref) is None:
            raise InputError(
                f"{path}: has a height of {ref!r}, which board type {board_type.name!r} does not have.",
                action="Use the heights of a run of this board type.",
            )
    return {
        ref: (height.height_mm, height.sigma_mm)
        for ref, height in found.items()
        if height.height_mm is not None and height.sigma_mm is not None
    }


def stitch_document(stitch: Stitch) -> dict[str, Any]:
    """Return the JSON object of a result. Null matrices are kept; optional keys without a value are left out."""
    document = stitch.model_dump(mode="json")
    for key in _LEFT_OUT_IF_NONE:
        if document[key] is None:
            del document[key]
    return document


def stitch_text(stitch: Stitch) -> str:
    """Return the result as JSON text.

    pydantic's serializer writes the text, which for a large board takes a seventh of the time of `json.dumps`.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    unused = {key for key in _LEFT_OUT_IF_NONE if getattr(stitch, key) is None}
    text = stitch.model_dump_json(exclude=unused)
    # The text contains such a number, or a name that contains the same word. The slower writer raises an error only for
    # the number.
    if "NaN" in text or "Infinity" in text:
        json.dumps(stitch_document(stitch), allow_nan=False)
    return text


def without_components(stitch: Stitch) -> Stitch:
    """Return a result without its entries per component and per pair of frames.

    For a large board this leaves a tenth of the size.
    """
    quality = {key: value for key, value in stitch.quality.items() if key not in _LARGE}
    return stitch.model_copy(update={"components": None, "quality": quality})


def quality_of(text: str) -> dict[str, Any]:
    """Return the quality figures from the text of a result, without building the complete result."""
    quality: dict[str, Any] = from_json(text).get("quality", {})
    return quality


def component_tables(text: str) -> dict[str, dict[str, Any]]:
    """Return the quality's tables of components from the text of a result, without building the complete result."""
    quality = quality_of(text)
    return {key: table for key in _OF_COMPONENTS if isinstance(table := quality.get(key), dict)}


def write_stitch(path: Path, stitch: Stitch) -> None:
    """Write a result atomically: readers see either the old file or the complete new one."""
    write_json(path, stitch_document(stitch))
