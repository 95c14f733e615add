"""A request for a batch: which components, which of their pictures, and how they are encoded and packed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.hdr.merging import region_component
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering import ImageRequest
from vaoi_station.runs.archive.component_views import component_of
from vaoi_station.runs.batches.batch_job import MEDIA
from vaoi_station.runs.batches.containers import CONTAINERS, ContainerName

Corners = tuple[float, float, float, float]
_OF_MERGES = ("light", "px_per_mm", "min_coverage")


@dataclass(frozen=True)
class BatchRequest:
    """A request for the pictures of many components. At most one of the first three fields is given."""

    components: tuple[str, ...] = ()
    """Addresses; empty: all components."""
    within: Corners | None = None
    """Only components whose centre lies in this box: x0, y0, x1, y1 in CAD coordinates."""
    region: Corners | None = None
    """One picture per frame of this part of the board, in place of components."""
    images: ImageRequest = field(default_factory=ImageRequest)
    hdr: bool = False
    """One picture per component, merged of all its frames under one light, in place of one per frame."""
    format: str = "png"
    container: ContainerName = "multipart"

    def check(self) -> BatchRequest:
        """Return the request. Raise InputError if fields contradict each other or have values that do not exist."""
        given = [name for name in ("components", "within", "region") if getattr(self, name)]
        if len(given) > 1:
            raise InputError(
                f"batch: {given[0]} and {given[1]} are given together.", action="Give one of them, or none for all."
            )
        if self.container not in CONTAINERS:
            raise InputError.field("batch", "container", self.container, f"one of {', '.join(CONTAINERS)}")
        if self.format not in MEDIA:
            raise InputError.field("batch", "format", self.format, f"one of {', '.join(MEDIA)}")
        self.images.check()
        if self.hdr and (other := sorted(set(self.images.options()) - set(_OF_MERGES))):
            raise InputError(
                f"batch: {other[0]} has no meaning with hdr, whose pictures are merged of all frames of a light.",
                action=f"Give only {', '.join(_OF_MERGES)} with hdr.",
            )
        return self

    def parts(self, board_type: BoardType, px_per_mm: float) -> tuple[Component, ...]:
        """Return the components of the request. `px_per_mm` is the resolution of a region without one of its own.

        Raises:
            NotFoundError: a component is unknown.
            InputError: a box has no area or no component, or the region is off the board or too large.
        """
        if self.region is not None:
            resolution = self.images.framing.px_per_mm or px_per_mm
            return (region_component(self.region, board_type, resolution, "batch: region"),)
        if self.components:
            return tuple(component_of(board_type, ref) for ref in dict.fromkeys(self.components))
        if self.within is None:
            return board_type.components
        found = tuple(filter(_inside(self.within), board_type.components))
        if not found:
            shown = " ".join(f"{v:g}" for v in self.within)
            limit = f"a box x0,y0,x1,y1 around the centre of at least one component ({board_type.unit}, CAD)"
            raise InputError.field("batch", "within", shown, limit)
        return found


def smallest(parts: Sequence[Component]) -> Component:
    """Return the component with the smallest picture. A request that it refuses is refused by all."""
    return parts[int(np.argmin([part.width * part.height for part in parts]))]


def _inside(box: Corners) -> Callable[[Component], bool]:
    x0, y0, x1, y1 = box
    return lambda part: x0 <= part.center[0] <= x1 and y0 <= part.center[1] <= y1
