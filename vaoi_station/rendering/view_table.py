"""The views of many components as arrays: objects are made of those that are read, and of no others.

A board has thousands of views. To make an object of each takes as long as to compute them all, and needs not be done
where views are only counted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.crops import Crops
from vaoi_station.rendering.view import Plane, Tile, View


class Sights(NamedTuple):
    """From where the components of v views are seen."""

    toward: Floats
    """(v, 3) as `View.toward`."""
    lift_px: Floats
    """(v, 2) as `View.lift_px`."""


class Columns(NamedTuple):
    """What is known of v views, ordered by component, those of one component best first; fields as in `View`."""

    component: NDArray[np.int_]
    """(v,) number of the component."""
    key: NDArray[np.int_]
    """(v, 2) camera and row."""
    coverage: Floats
    off_center: Floats
    matrix: Floats
    """(v, 3, 3)."""
    outline_px: Floats
    """(v, 4, 2)."""
    tiles: Mapping[int, tuple[Tile, ...]]
    """By number of the view, for those that are distorted."""


@dataclass(frozen=True, eq=False)
class ViewTable(Mapping[str, tuple[View, ...]]):
    """The views of n components by address, best first."""

    addresses: Sequence[str]
    crops: Crops
    above_mm: Floats
    """(n,) height of the plane of each picture above the board's surface."""
    on_top: NDArray[np.bool_]
    """(n,) whether this plane is the top of the body."""
    columns: Columns
    sights: Callable[[], Sights]
    """Function that computes the sights of all views."""

    def __getitem__(self, address: str) -> tuple[View, ...]:
        """Make the views of a component."""
        k = self._number[address]
        first, end = self._first[k : k + 2].tolist()
        columns, crops, (toward, lift) = self.columns, self.crops, self._sights
        (width, height), resolution = crops.size[k].astype(int).tolist(), float(crops.px_per_mm[k])
        crop_matrix, above = crops.crop_from_cad[k], float(self.above_mm[k])
        plane: Plane = "top" if self.on_top[k] else "board"
        # Python's own numbers, made at once: one by one they take longer.
        numbers = (v[first:end].tolist() for v in (columns.key, columns.coverage, columns.off_center))
        return tuple(
            View(
                i, j, width, height, resolution, share, distance, crop_matrix, columns.matrix[n],
                columns.tiles.get(n, ()), columns.outline_px[n], toward[n], lift[n], plane, above,
            )
            for n, (i, j), share, distance in zip(range(first, end), *numbers, strict=True)
        )  # fmt: skip

    def __iter__(self) -> Iterator[str]:
        return iter(self._number)

    def __len__(self) -> int:
        return len(self._number)

    def counts_in(self, frames: Collection[tuple[int, int]]) -> dict[str, int]:
        """Return for each component the number of views in some frames."""
        inside = [key in frames for key in map(tuple, self.columns.key.tolist())]
        count = np.bincount(self.columns.component[inside], minlength=len(self.addresses))
        return {address: n for address, n in zip(self.addresses, count.tolist(), strict=True) if n}

    @cached_property
    def _number(self) -> dict[str, int]:
        return {address: k for k, address in enumerate(self.addresses)}

    @cached_property
    def _first(self) -> NDArray[np.int_]:
        """(n + 1,) number of the first view of each component, and of all views."""
        return np.searchsorted(self.columns.component, np.arange(len(self.addresses) + 1))

    @cached_property
    def _sights(self) -> Sights:
        return self.sights()
