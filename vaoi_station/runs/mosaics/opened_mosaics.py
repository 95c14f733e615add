"""The mosaics of runs that are held in memory: their names, plans, and overviews, from which tiles are cut."""

from __future__ import annotations

import re
import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import NotFoundError
from vaoi_station.frame_index import Box, FrameIndex
from vaoi_station.mosaic import MosaicGrid, MosaicPlan, TileRenderer
from vaoi_station.mosaic.grid import TILE_PX
from vaoi_station.mosaic.tiles import NODATA

MOST_PLANS = 8
"""Number of plans that are kept; one of a board of 400 × 410 mm takes 2 MB per layer."""
MOST_AHEAD = 2
"""Number of these that were made after their runs, before a caller asked: boards that pass displace no others."""
MOST_BYTES = 100_000_000
"""Memory of all overviews; one takes at most 7 MB, in colour 20 MB, and twice as much with 16 bits."""


class PlannedMosaic(NamedTuple):
    """What a worker made of all frames of a mosaic."""

    plan: MosaicPlan
    overview: Overview | None
    """None with HDR."""


@dataclass(eq=False)
class OpenedMosaic:
    """One mosaic of a run. All but plan and overview is made without frames, once for all tiles."""

    grid: MosaicGrid
    """The largest grid."""
    projector: FrameIndex
    planning: threading.Lock = field(default_factory=threading.Lock)
    """Held while a worker makes the plan, for which all who need it wait."""
    planned: PlannedMosaic | None = None
    asked: bool = False
    """Whether a caller has asked for a part of it."""
    _renderers: dict[int, TileRenderer] = field(default_factory=dict)

    @property
    def nbytes(self) -> int:
        """Memory of the overview."""
        return 0 if self.planned is None or self.planned.overview is None else self.planned.overview.nbytes

    def renderer(self, plan: MosaicPlan, reduction: int) -> TileRenderer:
        """Return what prepares the tiles of a reduced level by the plan of this mosaic."""
        found = self._renderers.get(reduction)
        if found is None:
            found = self._renderers[reduction] = TileRenderer(plan, self.projector, self.grid.reduced(reduction))
        return found


class OpenedMosaics:
    """The mosaics that were used last, within limits. Methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._opened: OrderedDict[Hashable, OpenedMosaic] = OrderedDict()

    def __len__(self) -> int:
        return len(self._opened)

    def get(self, key: Hashable) -> OpenedMosaic | None:
        """Return a mosaic that was added; None if it was not, or was displaced."""
        return self._opened.get(key)

    def use(self, key: Hashable, new: OpenedMosaic, *, asked: bool) -> OpenedMosaic:
        """Return the mosaic of a key, which is `new` if there was none, as the one that was used last.

        `asked`: a caller has asked for it.
        """
        with self._lock:
            opened = self._opened.setdefault(key, new)
            opened.asked |= asked
            self._opened.move_to_end(key)
            ahead = [k for k, other in self._opened.items() if not other.asked]
            for displaced in ahead[: max(len(ahead) - MOST_AHEAD, 0)]:
                del self._opened[displaced]
            while len(self._opened) > MOST_PLANS:
                self._opened.popitem(last=False)
        return opened

    def keep(self, opened: OpenedMosaic, planned: PlannedMosaic) -> None:
        """Keep plan and overview of a mosaic, in place of mosaics that were used less lately."""
        with self._lock:
            opened.planned = planned
            total = sum(other.nbytes for other in self._opened.values())
            for key, other in list(self._opened.items()):
                if total > MOST_BYTES and other is not opened and other.nbytes:
                    total -= other.nbytes
                    del self._opened[key]


class Overview:
    """The levels of one mosaic, from the one that is reduced by `reduction` to one that fits into a tile."""

    def __init__(self, picture: NDArray[Any] | None, reduction: int) -> None:
        """Halve a mosaic that is reduced by `reduction`, a power of two, until it fits into a tile.

        `picture` is None if no frame shows any of the board.
        """
        self.reduction = reduction
        """By how much the largest level is reduced."""
        self._levels = [] if picture is None else [picture]
        while self._levels and max(self._levels[-1].shape[:2]) > TILE_PX:
            self._levels.append(halved(self._levels[-1]))

    @property
    def nbytes(self) -> int:
        """Memory of all levels."""
        return sum(level.nbytes for level in self._levels)

    def level(self, reduction: int) -> NDArray[Any] | None:
        """Return the board reduced by a factor, 0 where no frame shows it; None if none shows any of it.

        Args:
            reduction: a power of two, at least that of the largest level.
        """
        if not self._levels:
            return None
        steps = (reduction // self.reduction).bit_length() - 1
        picture = self._levels[min(steps, len(self._levels) - 1)]
        for _ in range(steps - len(self._levels) + 1):
            picture = halved(picture)
        return picture

    def cut(self, reduction: int, box: Box) -> NDArray[Any]:
        """Return a part of the board reduced by a factor; see `level`."""
        picture = self.level(reduction)
        x0, y0, x1, y1 = box
        return np.full((y1 - y0, x1 - x0), NODATA, np.uint8) if picture is None else picture[y0:y1, x0:x1]


def halved(picture: NDArray[Any]) -> NDArray[Any]:
    """Average a picture of whole grey levels over blocks of 2 × 2 px, of which only those count that are shown."""
    bottom, right = picture.shape[0] % 2, picture.shape[1] % 2
    even = cv2.copyMakeBorder(picture, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=[NODATA] * 3)
    h, w = even.shape[0] // 2, even.shape[1] // 2
    half = np.asarray(cv2.resize(even, (w, h), interpolation=cv2.INTER_AREA))
    if even.all():
        return half
    blocks = even.reshape(h, 2, w, 2, -1)
    corners = [even[y::2, x::2].reshape(h, w, -1)[..., 0] != NODATA for y in (0, 1) for x in (0, 1)]
    rows, columns = (np.logical_or.reduce(corners) & ~np.logical_and.reduce(corners)).nonzero()
    few = blocks[rows, :, columns].reshape(len(rows), 4, blocks.shape[-1]).astype(np.uint32)
    shown = np.maximum((few != NODATA).sum(1), 1)
    half[rows, columns] = ((few.sum(1) + shown // 2) // shown).reshape(len(rows), *picture.shape[2:])
    return half


_FIRST = "board"
_NAME = re.compile(
    _FIRST + r"(,light=(?P<light>[^,]+))?(,exposure=(?P<exposure>\d{1,9}(\.\d{1,6})?))?(?P<hdr>,hdr)?", re.DOTALL
)
_RESERVED = re.compile(r"[~,/\x00-\x1f\x7f]")
_WRITTEN = re.compile(r"~([0-9A-F]{2})")


class PictureName(NamedTuple):
    """Which frames a mosaic is made of."""

    light: str | None = None
    exposure_us: float | None = None
    hdr: bool = False

    def __str__(self) -> str:
        parts = [_FIRST]
        if self.light is not None:
            parts.append(f"light={_RESERVED.sub(lambda match: f'~{ord(match[0]):02X}', self.light)}")
        if self.exposure_us is not None:
            parts.append(f"exposure={self.exposure_us:.6f}".rstrip("0").rstrip("."))
        if self.hdr:
            parts.append("hdr")
        return ",".join(parts)


def parse_name(text: str) -> PictureName:
    """Parse the name of a mosaic; NotFoundError: it is no such name."""
    if (match := _NAME.fullmatch(text)) is None:
        raise NotFoundError(
            f"there is no mosaic {text!r:.80}; names are 'board', with ',light=NAME', ',exposure=µs' or ',hdr' added.",
            action="Take a name from the run's list of mosaics.",
            code="no-such-mosaic",
        )
    light, exposure_us = match["light"], match["exposure"]
    if light is not None:
        light = _WRITTEN.sub(lambda written: chr(int(written[1], 16)), light)
    return PictureName(light, None if exposure_us is None else float(exposure_us), match["hdr"] is not None)
