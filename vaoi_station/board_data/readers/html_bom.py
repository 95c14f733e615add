"""Read the data of InteractiveHtmlBom: its HTML page, or the object `pcbdata` as JSON.

y points down, lengths are in mm, angles are counter-clockwise as seen on the screen from the top. Source:
openscopeproject/InteractiveHtmlBom, DATAFORMAT.md.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from vaoi_station.board_data.contours import arc_points, circle_points, join
from vaoi_station.board_data.design import XY, Box, Design, Part, normalised, rotated
from vaoi_station.board_data.readers.lz_string import decompress
from vaoi_station.board_data.source_text import MOST_BYTES, decode
from vaoi_station.errors import InputError

_COMPRESSED = re.compile(r'pcbdata\s*=\s*JSON\.parse\(LZString\.decompressFromBase64\("([^"]*)"\)\)')
_PLAIN = re.compile(r"pcbdata\s*=\s*(?=\{)")


def is_html_bom(head: bytes) -> bool:
    """Return whether a file begins like a page of InteractiveHtmlBom or its data."""
    return (
        b"InteractiveHtmlBom" in head
        or b"Interactive BOM" in head
        or (b'"edges_bbox"' in head and head.lstrip()[:1] == b"{")
    )


def read_html_bom(data: bytes, path: Path) -> Design:
    """Read a page of InteractiveHtmlBom, or its data."""
    board = _board(decode(data, path), path)
    try:
        parts = tuple(_part(footprint) for footprint in board["footprints"])
        contours, _ = join(_edges(board.get("edges", [])))
        title = str((board.get("metadata") or {}).get("title") or path.stem)
        hidden = {int(n) for n in (board.get("bom") or {}).get("skipped", [])}
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: pcbdata lacks or has a wrong value at {error}.") from error
    fitted = tuple(p if n not in hidden else _unfitted(p) for n, p in enumerate(parts))
    outline, *cut_outs = contours or [[]]
    return Design(title, "html-bom", fitted, tuple(outline), tuple(map(tuple, cut_outs)))


def _board(text: str, path: Path) -> dict[str, Any]:
    if found := _COMPRESSED.search(text):
        text, start = decompress(found[1], path, MOST_BYTES), 0
    else:
        plain = _PLAIN.search(text)
        start = plain.end() if plain else 0
    try:
        board, _ = json.JSONDecoder().raw_decode(text, start)
    except (ValueError, RecursionError) as error:  # also of a number with more digits than Python converts
        raise InputError(f"{path}: has no readable pcbdata of InteractiveHtmlBom: {error}.") from error
    if not isinstance(board, dict):
        raise InputError(f"{path}: pcbdata is a {type(board).__name__}, must be an object.")
    return board


def _part(footprint: dict[str, Any]) -> Part:
    bbox = footprint["bbox"]
    x, y = map(float, bbox["pos"])
    relative, size = [float(v) for v in bbox.get("relpos", (0, 0))], [float(v) for v in bbox["size"]]
    # Before its rotation the box reaches from relpos to relpos + size, with y down.
    box = Box((relative[0], -relative[1] - size[1]), (relative[0] + size[0], -relative[1]))
    if not all(map(math.isfinite, (x, y, *relative, *size))):
        raise ValueError("bbox")
    return Part(
        ref=str(footprint["ref"]),
        side="bottom" if footprint["layer"] == "B" else "top",
        origin=(x, -y),
        rotation=normalised(float(bbox.get("angle", 0.0))),
        box=box if min(box.size) > 0 else None,
    )


def _unfitted(part: Part) -> Part:
    return replace(part, fitted=False)


def _edges(edges: list[dict[str, Any]]) -> Iterator[list[XY]]:
    for edge in edges:
        kind = edge.get("type")
        if kind in ("segment", "rect"):
            (x0, y0), (x1, y1) = edge["start"], edge["end"]
            corners = [(x0, -y0), (x1, -y1)]
            yield corners if kind == "segment" else [(x0, -y0), (x1, -y0), (x1, -y1), (x0, -y1), (x0, -y0)]
        elif kind == "circle":
            (x, y), radius = edge["start"], float(edge["radius"])
            yield circle_points((x, -y), radius)
        elif kind == "arc":
            (x, y), radius = edge["start"], float(edge["radius"])
            # Angles are clockwise on the screen from the x axis.
            ends = [rotated((radius, 0.0), -float(edge[key])) for key in ("startangle", "endangle")]
            first, last = ((x + dx, -y + dy) for dx, dy in ends)
            yield arc_points(first, last, (x, -y), clockwise=True)
        elif kind == "polygon":
            for polygon in edge.get("polygons", []):
                points = [(float(x), -float(y)) for x, y in polygon]
                yield [*points, points[0]]
