"""Read the data of InteractiveHtmlBom: its HTML page, or the object `pcbdata` as JSON.

y points down, lengths are in mm, angles are counter-clockwise as seen on the screen from the top. All generators use
one page, which draws the boxes so; pads, whose places the file states, lie within them. The generators for EAGLE,
EasyEDA and Altium state the corner of a box in the place of the origin; the last two draw boxes along the axes, at
angle 0. Source: openscopeproject/InteractiveHtmlBom, DATAFORMAT.md, render.js and ecad;
lianlian33/InteractiveHtmlBomForAD, ecad/AD10.js.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from vaoi_station.board_data.contours import arc_points, circle_points, find_contours
from vaoi_station.board_data.design import XY, Box, Design, Part, Placement, Side, normalised, noted, rotated
from vaoi_station.board_data.pin_rules import FITS_MM, LEAST_MARGIN, RULES, Rule
from vaoi_station.board_data.readers.lz_string import decompress
from vaoi_station.board_data.source_text import MOST_BYTES, decode
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

USUAL = Rule(mirrored=False, sign=1)
"""The page draws boxes so."""
LEAST_UNTURNED = 3
"""With fewer parts, all may lie along the axes by chance."""
_COMPRESSED = re.compile(r'pcbdata\s*=\s*JSON\.parse\(LZString\.decompressFromBase64\("([^"]*)"\)\)')
_PLAIN = re.compile(r"pcbdata\s*=\s*(?=\{)")


def is_html_bom(head: bytes) -> bool:
    """Return whether a file begins like a page of InteractiveHtmlBom or its data."""
    data = b'"edges_bbox"' in head and head.lstrip()[:1] == b"{"
    return data or b"InteractiveHtmlBom" in head or b"Interactive BOM" in head


def read_html_bom(data: bytes, path: Path) -> Design:
    """Read a page of InteractiveHtmlBom, or its data."""
    board = _board(decode(data, path), path)
    try:
        stated = [_part(footprint) for footprint in board["footprints"]]
        pads = [_pads(footprint) for footprint in board["footprints"]]
        contours = find_contours(_edges(board.get("edges", [])), "edges")
        title = str((board.get("metadata") or {}).get("title") or path.stem)
        hidden = {int(n) for n in (board.get("bom") or {}).get("skipped", [])}
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: pcbdata lacks or has a wrong value at {error}.") from error
    parts, notes = _by_pads(stated, pads)
    if len(parts) >= LEAST_UNTURNED and all(part.box and part.box.low[0] == 0 == part.box.high[1] for part in stated):
        parts = [replace(p, origin=p.center, box=Box.of_size(*p.box.size)) for p in parts if p.box is not None]
        if all(part.rotation == 0 for part in stated):
            text = "all boxes lie along the axes, at angle 0: the file states no angles of parts."
            notes.append(noted("angles-not-stated", text))
    return Design(
        name=title,
        format="html-bom",
        parts=tuple(replace(part, fitted=n not in hidden) for n, part in enumerate(parts)),
        outline=contours.outline,
        cut_outs=contours.others,
        islands=contours.islands,
        notes=(*notes, *contours.notes),
    )


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
    left, top = map(float, bbox.get("relpos", (0, 0)))
    width, height = map(float, bbox["size"])
    if not all(map(math.isfinite, (x, y, left, top, width, height))):
        raise ValueError("bbox")
    # Before its rotation the box reaches from relpos to relpos + size, with y down.
    box = Box((left, -top - height), (left + width, -top))
    return Part(
        ref=str(footprint["ref"]),
        side="bottom" if footprint["layer"] == "B" else "top",
        origin=(x, -y),
        rotation=normalised(float(bbox.get("angle", 0.0))),
        box=box if min(box.size) > 0 else None,
    )


def _pads(footprint: dict[str, Any]) -> list[XY]:
    """Return the places of the pads, y up."""
    found = [(float(pad["pos"][0]), -float(pad["pos"][1])) for pad in footprint.get("pads") or ()]
    if not all(map(math.isfinite, (v for at in found for v in at))):
        raise ValueError("pads")
    return found


def _by_pads(stated: list[Part], pads: list[list[XY]]) -> tuple[list[Part], list[Note]]:
    """Return the parts with boxes turned so that pads lie within them, for each side, and what decided."""
    parts, notes, outside = list(stated), [], []
    for side in get_args(Side):
        of_side = [n for n, part in enumerate(stated) if part.side == side and part.box is not None]
        judged = [n for n in of_side if pads[n]]
        counts = {rule: sum(_holds(_turned(stated[n], rule), pads[n]) for n in judged) for rule in (USUAL, *RULES)}
        rule = max(counts, key=lambda rule: counts[rule])
        if counts[rule] < counts[USUAL] + LEAST_MARGIN:
            rule = USUAL
        for n in of_side:
            parts[n] = _turned(stated[n], rule)
        outside += [parts[n].ref for n in judged if not _holds(parts[n], pads[n])]
        if of_side and rule != USUAL:
            text = (
                "boxes of parts on the {side} are {rule}, which is not usual: {fit} of {parts} parts have their pads "
                "within their box so, {usual} by the usual rule."
            )
            values = {"rule": str(rule), "fit": counts[rule], "parts": len(judged), "usual": counts[USUAL]}
            notes.append(noted("boxes-by-pads", text, side=side, **values))
    if outside:
        text = "pads of {count} parts lie outside their box; check them in the picture: {names}."
        notes.append(noted("pads-outside-box", text, count=len(outside), names=outside))
    return parts, notes


def _turned(part: Part, rule: Rule) -> Part:
    box = part.box.mirrored() if part.box is not None and rule.mirrored else part.box
    return replace(part, rotation=rule.rotation(part.rotation), box=box)


def _holds(part: Part, pads: list[XY]) -> bool:
    """Return whether the pads of a part lie within its box."""
    at, box = Placement(False, part.rotation, part.origin), part.box or Box.of_size(0.0, 0.0)
    points = (at.undo(pad) for pad in pads)
    return all(a - FITS_MM <= v <= b + FITS_MM for p in points for a, v, b in zip(box.low, p, box.high, strict=True))


def _edges(edges: list[dict[str, Any]]) -> Iterator[list[XY]]:
    for edge in edges:
        kind = edge.get("type")
        if kind in ("segment", "rect"):
            (x0, y0), (x1, y1) = edge["start"], edge["end"]
            corners = [(x0, -y0), (x1, -y1)]
            yield corners if kind == "segment" else [(x0, -y0), (x1, -y0), (x1, -y1), (x0, -y1), (x0, -y0)]
        elif kind in ("circle", "arc"):
            (x, y), radius = edge["start"], float(edge["radius"])
            if kind == "circle":
                yield circle_points((x, -y), radius)
                continue
            # Angles are clockwise on the screen from the x axis.
            ends = [rotated((radius, 0.0), -float(edge[key])) for key in ("startangle", "endangle")]
            first, last = ((x + dx, -y + dy) for dx, dy in ends)
            yield arc_points(first, last, (x, -y), clockwise=True)
        elif kind == "polygon":
            for polygon in edge.get("polygons", []):
                points = [(float(x), -float(y)) for x, y in polygon]
                yield [*points, points[0]]
