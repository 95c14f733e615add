"""The brightness of every row relative to the others: lamps flicker by a percent from pulse to pulse.

Two rows that show the same place give the ratio of their brightness. The ratios of all pairs of rows give one level per
row; their mean is 1 for each light. Only with flat fields: without them, the corners of frames would count as flicker.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.photometry import FlatFields, Taken
from vaoi_station.photometry.noise import FULL_SCALE, grey_levels

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
MOST_ROWS = 1000
"""Largest number of rows of one light that are compared: memory grows with its square."""


class _Samples(NamedTuple):
    """Brightness of windows: number of the point, row, and logarithm of the radiance, each (k,)."""

    point: NDArray[np.int_]
    row: NDArray[np.int_]
    log: Floats


class _Sight(NamedTuple):
    """The points that a frame shows: their numbers (k,), and their pixels x and y, each (k,)."""

    row: int
    point: NDArray[np.int_]
    x: NDArray[np.int_]
    y: NDArray[np.int_]


def row_levels(
    taken: Mapping[tuple[int, int], Taken],
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    fields: FlatFields,
    frame: Callable[[int, int], NDArray[Any] | None],
    most_pixels: float = math.inf,
) -> Floats:
    """Estimate the brightness (m,) of the rows of a run; 1 for all without flat fields or a CAD mapping.

    It is 1 as well for all rows of a light with more than `MOST_ROWS` rows, and for all rows of the run if the frames
    of one camera have more than `most_pixels`.

    Args:
        taken: what the frames (camera, row) were taken with; frames that are not named are not used.
        board_type: board type of the run.
        stitch: result of the run.
        cameras: cameras with which it was stitched.
        fields: flat fields of the cameras.
        frame: returns the pixels of a camera and row, or None for a missing frame.
        most_pixels: largest number of pixels of all frames that are asked for. The cameras that show most of the board
            are used, as many as the number permits: one camera sees every row.
    """
    levels = np.ones(len(stitch.row_motion))
    if not fields or stitch.cad_matrix is None:
        return levels
    lights = {row: of.light for (_, row), of in sorted(taken.items())}
    counts = Counter(lights.values())
    used = {key: of for key, of in taken.items() if counts[lights[key[1]]] <= MOST_ROWS}
    samples = _samples(used, board_type, FrameIndex.of_result(stitch, cameras), fields, frame, most_pixels)
    for light in (light for light, count in counts.items() if count <= MOST_ROWS):
        rows = np.array([row for row in sorted(lights) if lights[row] == light])
        levels[rows] = np.exp(_solve(samples, rows))
    return levels


def at_level(taken: Taken, level: float) -> Taken:
    """Return what a frame would have been taken with if its row were as bright as the others."""
    return taken._replace(exposure_us=taken.exposure_us * level)


def _samples(
    taken: Mapping[tuple[int, int], Taken],
    board_type: BoardType,
    index: FrameIndex,
    fields: FlatFields,
    frame: Callable[[int, int], NDArray[Any] | None],
    most_pixels: float,
) -> _Samples:
    low, high = board_type.extent()
    t = (np.arange(_POINTS) + 0.5) / _POINTS
    cad = np.stack(np.meshgrid(*(lo + (hi - lo) * t for lo, hi in zip(low, high, strict=True))), -1).reshape(-1, 2)
    sights: dict[int, list[_Sight]] = {i: [] for i in range(len(index.cameras))}
    for i, row in sorted(taken):
        at = index.raw_px(i, row, cad)
        seen = np.flatnonzero(index.cameras[i].sees(at, _SIDE_PX))
        if len(seen):
            sights[i].append(_Sight(row, seen, *at[seen].round().astype(int).T))
    found: list[tuple[NDArray[np.int_], NDArray[np.int_], Floats]] = []
    chosen = _chosen(sights, index.cameras, most_pixels)
    for i in chosen:
        for row, seen, x, y in sights[i]:
            of, pixels = taken[i, row], frame(i, row)
            if pixels is None:
                continue
            maps = fields.maps(i, of.light)
            signal, full = _windows(pixels, x, y)
            signal = signal - (maps.dark if isinstance(maps.dark, float) else maps.dark[y, x])
            flat = maps.flat[y, x] if maps.flat is not None else np.ones(len(x))
            good = ~full & (signal > _LEAST_SIGNAL) & (flat > 0)
            scale = flat[good] * of.exposure_us * of.gain
            found.append((seen[good], np.full(int(good.sum()), row), np.log(signal[good] / scale)))
    if not found:
        return _Samples(np.zeros(0, np.int_), np.zeros(0, np.int_), np.zeros(0))
    return _Samples(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _chosen(sights: Mapping[int, Sequence[_Sight]], cameras: Sequence[Camera], most_pixels: float) -> list[int]:
    """Return the cameras that show most of the board, as many as have no more pixels in their frames than the limit."""
    chosen, pixels = [], 0
    for i in sorted(sights, key=lambda i: -sum(len(sight.point) for sight in sights[i])):
        pixels += len(sights[i]) * cameras[i].width_px * cameras[i].height_px
        if pixels > most_pixels:
            break
        chosen.append(i)
    return chosen


def _windows(pixels: NDArray[Any], x: NDArray[np.int_], y: NDArray[np.int_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the mean grey level (k,) of windows around pixels of a frame, and which are or touch saturated ones.

    Only the windows are read: filters over whole frames of a long run would exceed the time that a worker has.
    """
    reach = _SIDE_PX // 2 + 1
    across = np.arange(-reach, reach + 1)
    # One below the other, so that they are one picture of few pixels: (k · side, side).
    strip = pixels[(y[:, None] + across).reshape(-1)[:, None], np.repeat(x[:, None] + across, len(across), 0)]
    side = len(across)
    grey = grey_levels(strip).reshape(-1, side, side)
    limit = FULL_SCALE if pixels.dtype == np.uint8 else 65535
    full = (strip >= limit).reshape(len(x), -1).any(1)
    return grey[:, 1:-1, 1:-1].mean((1, 2), dtype=np.float64), full


def _solve(samples: _Samples, rows: NDArray[np.int_]) -> Floats:
    """Return the logarithms of the levels (k,) of rows of one light; their mean is 0."""
    # One value for each point and row: the mean of the cameras that show it.
    tables = np.full((len(rows), _POINTS**2), np.nan)
    order = np.argsort(samples.row, kind="stable")
    ends = np.searchsorted(samples.row, [rows, rows + 1], sorter=order)
    for n, (first, end) in enumerate(ends.T):
        mine = order[first:end]
        count = np.bincount(samples.point[mine], minlength=_POINTS**2)
        total = np.bincount(samples.point[mine], samples.log[mine], minlength=_POINTS**2)
        tables[n] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    known = np.isfinite(tables)
    shared = known.astype(np.float32) @ known.astype(np.float32).T
    # Normal equations: one line for each pair would be a matrix that grows with the cube of the rows.
    system, right = np.eye(len(rows)) * _RIDGE**2, np.zeros(len(rows))
    # Rows that are 1, 2, 4, … apart: near ones, and far ones so that no error adds up from row to row. Those that show
    # too little of the board do not count.
    shown = np.flatnonzero(np.diagonal(shared) >= _LEAST_PAIRS)
    pairs = [(a, b) for k in range(len(shown).bit_length()) for a, b in zip(shown, shown[2**k :], strict=False)]
    for a, b in pairs:
        if shared[a, b] < _LEAST_PAIRS:
            continue
        weight = shared[a, b] / _LEAST_PAIRS
        # The median: bodies that stand above the board show other places in the two rows.
        both = known[a] & known[b]
        ratio = float(np.median(tables[a, both] - tables[b, both])) * weight
        system[[a, b], [a, b]] += weight
        system[[a, b], [b, a]] -= weight
        right[[a, b]] += ratio, -ratio
    found = np.linalg.solve(system, right)
    found -= found.mean()
    return np.asarray(np.where(np.abs(found) < _MOST_LEVEL, found, 0.0))
