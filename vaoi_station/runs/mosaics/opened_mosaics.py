"""The mosaics of runs that are held in memory: what their tiles are made with, their plans and their overviews."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field

from vaoi_station.mosaic import MosaicGrid, MosaicPlan, TileRenderer
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.runs.mosaics.overview import Overview
from vaoi_station.runs.workers.mosaic_jobs import Slots

MOST_PLANS = 8
"""Number of plans that are kept; one of a board of 400 × 410 mm takes 2 MB per layer."""
MOST_AHEAD = 2
"""Number of these that were made after their runs, before a caller asked: boards that pass displace no others."""
MOST_BYTES = 100_000_000
"""Memory of all overviews; that of a board of 400 × 410 mm at 40 px/mm takes 22 MB, in colour 66 MB."""


@dataclass(eq=False)
class OpenedMosaic:
    """One mosaic of a run. All but the plan and the overview is made without frames, once for all tiles."""

    grid: MosaicGrid
    """The largest grid."""
    projector: FrameProjector
    slots: Slots
    """Slots of the usable frames of the run."""
    planning: threading.Lock = field(default_factory=threading.Lock)
    """Held while a worker makes the plan for a caller, for which other callers wait."""
    plan: MosaicPlan | None = None
    overview: Overview | None = None
    asked: bool = False
    """Whether a caller has asked for a part of it."""
    ordered: bool = False
    """Whether the overview was ordered since it was there last."""
    _renderers: dict[int, TileRenderer] = field(default_factory=dict)

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

    def keep(self, opened: OpenedMosaic, overview: Overview) -> None:
        """Keep the overview of a mosaic, in place of those of mosaics that were used less lately."""
        with self._lock:
            opened.overview, opened.ordered = overview, False
            others = [other for other in self._opened.values() if other.overview is not None and other is not opened]
            total = overview.nbytes + sum(other.overview.nbytes for other in others if other.overview is not None)
            for other in others:
                if total > MOST_BYTES and other.overview is not None:
                    total -= other.overview.nbytes
                    other.overview = None
