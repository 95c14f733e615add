"""The views of many components as arrays, of which objects are made when the first one is read.

A board has thousands of views. To make an object of each takes half as long as to compute them all, and is not needed
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
        """Return the views of a component; the first call makes those of all."""
        return self._views[address]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    def views_of(self, number: int) -> tuple[View, ...]:
        """Make the views of the component with a number, and keep none: they take several times the arrays' memory."""
        first, end = np.searchsorted(self.columns.component, (number, number + 1)).tolist()
        return tuple(view for _, view in self._made(first, end))

    def counts_in(self, frames: Collection[tuple[int, int]]) -> dict[str, int]:
        """Return for each component the number of views in some frames."""
        inside = [key in frames for key in map(tuple, self.columns.key.tolist())]
        count = np.bincount(self.columns.component[inside], minlength=len(self.addresses))
        return {address: n for address, n in zip(self.addresses, count.tolist(), strict=True) if n}

    def by_frame(self) -> tuple[NDArray[np.int_], list[int]]:
        """Return the numbers (v,) of all views, those of one frame together, and where those of each frame begin."""
        order = np.lexsort(self.columns.key.T)
        key = self.columns.key[order]
        changes = np.flatnonzero((key[1:, 0] != key[:-1, 0]) | (key[1:, 1] != key[:-1, 1])) + 1
        return order, [0, *changes.tolist()] if len(order) else []

    @cached_property
    def _views(self) -> dict[str, tuple[View, ...]]:
        found: list[list[View]] = [[] for _ in self.addresses]
        for k, view in self._made(0, len(self.columns.component)):
            found[k].append(view)
        return {address: tuple(views) for address, views in zip(self.addresses, found, strict=True)}

    @cached_property
    def _sights(self) -> Sights:
        return self.sights()

    @cached_property
    def _pictures(self) -> list[tuple[int, int, float, Floats, Plane, float]]:
        """Size, resolution, matrix from CAD, plane and height of the picture of each component."""
        crops = self.crops
        size, planes = crops.size.astype(int).T.tolist(), np.where(self.on_top, "top", "board").tolist()
        return list(
            zip(*size, crops.px_per_mm.tolist(), crops.crop_from_cad, planes, self.above_mm.tolist(), strict=True)
        )

    def _made(self, first: int, end: int) -> Iterator[tuple[int, View]]:
        """Make the views from `first` to `end`, which is excluded; yield each with the number of its component."""
        columns, (toward, lift), part = self.columns, self._sights, slice(first, end)
        # Python's own numbers, and rows of arrays, made at once: one by one they take longer than the views themselves.
        numbers = (v[part].tolist() for v in (columns.component, columns.key, columns.coverage, columns.off_center))
        arrays = (v[part] for v in (columns.matrix, columns.outline_px, toward, lift))
        for n, (k, (i, j), share, distance, matrix, corners, sight, shift) in enumerate(
            zip(*numbers, *arrays, strict=True), first
        ):
            width, height, resolution, crop_matrix, plane, above_mm = self._pictures[k]
            yield k, View(
                i, j, width, height, resolution, share, distance, crop_matrix, matrix,
                columns.tiles.get(n, ()), corners, sight, shift, plane, above_mm,
            )  # fmt: skip
