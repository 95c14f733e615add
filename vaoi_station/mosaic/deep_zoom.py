"""Levels and tiles of a mosaic as viewers ask for them: Deep Zoom Images (DZI) and IIIF Image API 3, level 0.

Level k here is the mosaic reduced by 2ᵏ; level 0 is the largest. DZI counts from the other end: its last level is the
largest, and its level 0 has one pixel.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import quoteattr

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.mosaic.grid import MosaicGrid

TILE_PX = 256
Box = tuple[int, int, int, int]
_DZI = "http://schemas.microsoft.com/deepzoom/2008"
_IIIF = "http://iiif.io/api/image/3/context.json"


def levels_of(grid: MosaicGrid) -> int:
    """Return the number of reductions for which a mosaic has tiles: until the smallest fits into one tile."""
    return 1 + max(math.ceil(math.log2(max(grid.width, grid.height) / TILE_PX)), 0)


def dzi_document(grid: MosaicGrid, suffix: str) -> str:
    """Return the .dzi file of a mosaic whose tiles have this suffix."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<Image xmlns={quoteattr(_DZI)} Format={quoteattr(suffix)} Overlap="0" TileSize="{TILE_PX}">'
        f'<Size Width="{grid.width}" Height="{grid.height}"/></Image>\n'
    )


def dzi_reduction(grid: MosaicGrid, level: int) -> int:
    """Return the factor by which a level of DZI is reduced. Raise NotFoundError if there is no such level."""
    last = math.ceil(math.log2(max(grid.width, grid.height)))
    if not 0 <= level <= last:
        raise NotFoundError(
            f"the mosaic has the levels 0 to {last}; there is no level {level}.",
            action="Take levels from the .dzi file.",
            code="no-such-tile",
        )
    return int(2 ** (last - level))


def tile_box(grid: MosaicGrid, column: int, row: int) -> Box:
    """Return the part of a reduced mosaic that a tile shows. Raise NotFoundError if there is no such tile."""
    columns, rows = -(-grid.width // TILE_PX), -(-grid.height // TILE_PX)
    if not (0 <= column < columns and 0 <= row < rows):
        raise NotFoundError(
            f"this level has {columns}×{rows} tiles, counted from 0; there is no tile {column}_{row}.",
            action="Take tiles of the level's size.",
            code="no-such-tile",
        )
    x, y = column * TILE_PX, row * TILE_PX
    return x, y, min(x + TILE_PX, grid.width), min(y + TILE_PX, grid.height)


def iiif_document(grid: MosaicGrid, address: str) -> Mapping[str, Any]:
    """Return the info.json of a mosaic with this address."""
    factors = [2**k for k in range(levels_of(grid))]
    sizes = [{"width": -(-grid.width // f), "height": -(-grid.height // f)} for f in reversed(factors)]
    small = [s for s in sizes if max(s["width"], s["height"]) <= TILE_PX]
    return {
        "@context": _IIIF,
        "id": address,
        "type": "ImageService3",
        "protocol": "http://iiif.io/api/image",
        "profile": "level0",
        "width": grid.width,
        "height": grid.height,
        "maxWidth": TILE_PX,
        "maxHeight": TILE_PX,
        "sizes": small,
        "tiles": [{"width": TILE_PX, "height": TILE_PX, "scaleFactors": factors}],
        "extraFormats": ["png"],
    }


def iiif_tile(grid: MosaicGrid, region: str, size: str) -> tuple[int, Box]:
    """Return reduction and part of the picture that an IIIF request of level 0 asks for.

    Args:
        grid: the largest mosaic.
        region: `full`, or `x,y,w,h` in pixels of the largest mosaic.
        size: `max`, `w,h` or `w,`.

    Raises:
        InputError: the request is not one of the tiles and sizes that info.json lists.
    """
    if region == "full":
        x, y, w, h = 0, 0, grid.width, grid.height
    else:
        found = re.fullmatch(r"(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9})", region)
        if found is None:
            raise _not_listed("region", region)
        x, y, w, h = map(int, found.groups())
    for level in range(levels_of(grid)):
        factor = 2**level
        reduced = grid.reduced(factor)
        side = TILE_PX * factor
        if x % side or y % side or x >= grid.width or y >= grid.height:
            continue
        if (w, h) != (min(side, grid.width - x), min(side, grid.height - y)):
            continue
        box = tile_box(reduced, x // side, y // side)
        wanted = box[2] - box[0], box[3] - box[1]
        if size in (f"{wanted[0]},{wanted[1]}", f"{wanted[0]},") or (size == "max" and level == 0):
            return factor, box
    raise _not_listed("region/size", f"{region}/{size}")


def _not_listed(key: str, value: str) -> InputError:
    return InputError.field("IIIF level 0", key, value, "one of the tiles and sizes of info.json")
