"""The mosaics of runs that are held in memory: what their tiles are made with, their plans and their overviews."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import NamedTuple

from vaoi_station.mosaic import MosaicGrid, MosaicPlan, TileRenderer
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.runs.mosaics.overview import Overview
from vaoi_station.runs.workers.picture_jobs import Slots

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
    projector: FrameProjector
    slots: Slots
    """Slots of the usable frames of the run."""
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
