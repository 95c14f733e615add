"""Write a mosaic as a file: tiles are rendered row by row, frames are read when the first tile needs them."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.pyramids import TILE_PX, PyramidLayout, write_pyramid
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import MosaicPlan
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.survey import ReadFrame
from vaoi_station.mosaic.tile_specs import TileRenderer
from vaoi_station.mosaic.tiles import NODATA, Scratch, render_tile
from vaoi_station.version import __version__

CACHE_BYTES = 128_000_000
"""Memory for frames that later tiles may need again."""


class FrameCache:
    """The frames that were read last, up to a number of bytes."""

    def __init__(self, read: ReadFrame, most_bytes: int = CACHE_BYTES) -> None:
        self._read, self._most = read, most_bytes
        self._frames: OrderedDict[tuple[int, int], NDArray[Any] | None] = OrderedDict()
        self._bytes = 0

    def __call__(self, camera: int, row: int) -> NDArray[Any] | None:
        """Return a frame, from memory if it was read lately."""
        key = camera, row
        if key in self._frames:
            self._frames.move_to_end(key)
            return self._frames[key]
        frame = self._frames[key] = self._read(camera, row)
        self._bytes += 0 if frame is None else frame.nbytes
        while self._bytes > self._most and len(self._frames) > 1:
            _, old = self._frames.popitem(last=False)
            self._bytes -= 0 if old is None else old.nbytes
        return frame


def write_mosaic(
    path: Path, plan: MosaicPlan, projector: FrameProjector, grid: MosaicGrid, read: ReadFrame
) -> PyramidLayout:
    """Render a mosaic and write it as a pyramidal TIFF; return what was written. The file appears when complete."""
    cached = FrameCache(read)
    sample = next((f for f in (read(p.taken.camera, p.taken.row) for p in plan.frames) if f is not None), None)
    colour = sample is not None and sample.ndim == 3 and not plan.hdr
    dtype = np.dtype(np.float32) if plan.hdr else np.dtype(np.uint8) if sample is None else sample.dtype
    layout = PyramidLayout(
        grid.width,
        grid.height,
        dtype,
        3 if colour else 1,
        "nan" if plan.hdr else str(NODATA),
        grid.px_per_mm,
        f"vaoi mosaic, vaoi_station {__version__}",
    )
    renderer = TileRenderer(plan, projector, grid)

    columns, rows = (side // TILE_PX for side in renderer.block_px)
    block: NDArray[Any] | None = None
    rendered: tuple[int, int] | None = None
    scratch = Scratch()

    def tile(x: int, y: int) -> NDArray[Any]:
        nonlocal block, rendered
        place = x // columns, y // rows
        if place != rendered:
            rendered = place
            x0, y0 = place[0] * columns * TILE_PX, place[1] * rows * TILE_PX
            x1, y1 = x0 + columns * TILE_PX, y0 + rows * TILE_PX
            box = x0, y0, min(x1, grid.width), min(y1, grid.height)
            block = render_tile(renderer.spec(box), cached, scratch)
        whole = np.full(layout.tile_shape, np.nan if plan.hdr else NODATA, dtype)
        if block is not None:
            left, top = x % columns * TILE_PX, y % rows * TILE_PX
            part = block[top : top + TILE_PX, left : left + TILE_PX]
            # TIFF has the channels in the order red, green, blue; frames have them in that of OpenCV.
            whole[: part.shape[0], : part.shape[1]] = part if part.ndim == 2 else part[..., ::-1]
        return whole

    write_pyramid(path, layout, tile)
    return layout
