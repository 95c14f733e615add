"""The brightness of every row relative to the others: lamps flicker by a percent from pulse to pulse.

Two rows that show the same place give the ratio of their brightness. The ratios of all pairs of rows give one level per
row; their mean is 1 for each light. Only with flat fields: without them, the corners of frames would count as flicker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, RecordingHead, Stitch
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.noise import grey_levels
from vaoi_station.photometry.radiance import is_saturated

_POINTS = 64
"""Points per side of the grid over the board at which brightness is compared."""
_SIDE_PX = 5
"""Side of the windows whose means are compared."""
_LEAST_SIGNAL = 12.0
"""Least signal of a window in grey levels; darker ones have more noise than lamps have flicker."""
_LEAST_PAIRS = 40
"""Least number of windows that two rows must share."""
_MOST_LEVEL = 0.4
"""Largest deviation of a level, as a logarithm, that is believed."""
_RIDGE = 1e-3
"""Weight that keeps rows without neighbours at 1."""


class _Samples(NamedTuple):
    """Brightness of windows: number of the point, row, and logarithm of the radiance, each (k,)."""

    point: NDArray[np.int_]
    row: NDArray[np.int_]
    log: Floats


def row_levels(
    head: RecordingHead,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    fields: FlatFields,
    frame: Callable[[int, int], NDArray[Any] | None],
) -> Floats:
    """Estimate the brightness (m,) of the rows of a run; 1 for all without flat fields or a CAD mapping.

    `frame` returns the pixels of a camera and row, or None for a missing frame.
    """
    levels = np.ones(head.rows)
    if not fields or stitch.cad_matrix is None:
        return levels
    samples = _samples(head, board_type, stitch, stitch.cameras(cameras), fields, frame)
    for light in dict.fromkeys(head.light(row) for row in range(head.rows)):
        rows = np.array([row for row in range(head.rows) if head.light(row) == light])
        levels[rows] = np.exp(_solve(samples, rows))
    return levels


def _samples(
    head: RecordingHead,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    fields: FlatFields,
    frame: Callable[[int, int], NDArray[Any] | None],
) -> _Samples:
    low, high = board_type.extent()
    t = (np.arange(_POINTS) + 0.5) / _POINTS
    cad = np.stack(np.meshgrid(*(lo + (hi - lo) * t for lo, hi in zip(low, high, strict=True))), -1).reshape(-1, 2)
    height = stitch.surface.height_mm(cad) if stitch.surface is not None else np.zeros(len(cad))
    found: list[tuple[NDArray[np.int_], NDArray[np.int_], Floats]] = []
    for row in range(head.rows):
        place = apply(np.asarray(stitch.row_motion[row]) @ np.asarray(stitch.cad_matrix), cad)
        for i, camera in enumerate(cameras):
            at = camera.project(place, height)
            seen = np.flatnonzero(camera.sees(at, _SIDE_PX))
            pixels = frame(i, row) if len(seen) else None
            if pixels is None:
                continue
            maps = fields.maps(i, head.light(row))
            x, y = at[seen].round().astype(int).T
            signal = cv2.blur(grey_levels(pixels), (_SIDE_PX, _SIDE_PX))[y, x]
            signal = signal - (maps.dark if isinstance(maps.dark, float) else maps.dark[y, x])
            full = cv2.dilate(is_saturated(pixels).astype(np.uint8), np.ones((_SIDE_PX, _SIDE_PX), np.uint8))[y, x]
            flat = maps.flat[y, x] if maps.flat is not None else np.ones(len(x))
            good = (full == 0) & (signal > _LEAST_SIGNAL) & (flat > 0)
            scale = flat[good] * head.exposure_us(i, row) * head.gain(i, row)
            found.append((seen[good], np.full(int(good.sum()), row), np.log(signal[good] / scale)))
    if not found:
        return _Samples(np.zeros(0, np.int_), np.zeros(0, np.int_), np.zeros(0))
    return _Samples(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _solve(samples: _Samples, rows: NDArray[np.int_]) -> Floats:
    """Return the logarithms of the levels (k,) of rows of one light; their mean is 0."""
    # One value for each point and row: the mean of the cameras that show it.
    tables = np.full((len(rows), _POINTS**2), np.nan)
    for n, row in enumerate(rows):
        mine = samples.row == row
        count = np.bincount(samples.point[mine], minlength=_POINTS**2)
        total = np.bincount(samples.point[mine], samples.log[mine], minlength=_POINTS**2)
        tables[n] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    equations, values = [], []
    for a in range(len(rows)):
        for b in range(a + 1, len(rows)):
            both = np.isfinite(tables[a]) & np.isfinite(tables[b])
            if both.sum() < _LEAST_PAIRS:
                continue
            line = np.zeros(len(rows))
            line[[a, b]] = 1, -1
            weight = np.sqrt(both.sum() / _LEAST_PAIRS)
            equations.append(line * weight)
            # The median: bodies that stand above the board show other places in the two rows.
            values.append(float(np.median(tables[a, both] - tables[b, both])) * weight)
    ridge = np.eye(len(rows)) * _RIDGE
    system = np.concatenate([np.array(equations).reshape(-1, len(rows)), ridge])
    found = np.linalg.lstsq(system, np.concatenate([values, np.zeros(len(rows))]), rcond=None)[0]
    found -= found.mean()
    return np.asarray(np.where(np.abs(found) < _MOST_LEVEL, found, 0.0))
