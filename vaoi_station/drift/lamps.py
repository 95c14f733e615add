"""Brightness of the board in a run, per camera and light, from a sparse sample of the stitched frames.

The samples lie on a grid in CAD coordinates, so that successive boards of one type are sampled at the same places:
where the board lies in the picture, empty rows and the belt have no influence.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.drift.checks import LampCheck
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, RecordingHead, Stitch
from vaoi_station.photometry.noise import FULL_SCALE

Frame = Callable[[int, int], NDArray[Any] | None]
"""Returns the pixels of the frame of a camera and row; None if the frame is missing."""
SAME_EXPOSURE = math.log(1.1)
"""Products of exposure and gain count as equal if their logarithms differ by at most this.

Different ones are kept apart, because a dark level that is not known changes the brightness of short exposures."""
_POINTS = 5000
"""Number of points of the grid over the extent of a board."""
_LEAST_POINTS = 100
"""Least number of samples from which a brightness is computed."""
_MOST_FRAMES = 12
"""Largest number of frames of a camera, light and exposure that are sampled; they are spread over the board."""
_TRIM = 0.1
"""Share of the darkest and of the brightest samples that the mean leaves out: glints and holes."""
_DARKEST, _BRIGHTEST = 4.0, 240.0
"""Mean grey levels (of 255) outside which a brightness is not compared: dark level, saturation."""


def measure_lamps(stitch: Stitch, board: BoardType | None, head: RecordingHead, frame: Frame) -> tuple[LampCheck, ...]:
    """Measure how bright the board is in a run, for every camera, light and exposure.

    Nothing is measured without a board type or a CAD mapping. `head` gives light, exposure and gain of the frames.
    """
    tester_from_cad = stitch.tester_from_cad
    if board is None or tester_from_cad is None:
        return ()
    points = tester_from_cad(grid_on_board(board))
    rows: dict[tuple[int, str], list[int]] = defaultdict(list)
    for camera, matrices in enumerate(stitch.image_matrices):
        for row, matrix in enumerate(matrices):
            if matrix is not None:
                rows[camera, head.light(row) or ""].append(row)
    found: list[LampCheck] = []
    for (camera, light), lit in rows.items():
        exposures = {row: head.exposure_us(camera, row) * head.gain(camera, row) for row in lit}
        for group in _groups(exposures):
            spread = np.rint(np.linspace(0, len(group) - 1, min(len(group), _MOST_FRAMES))).astype(int)
            samples = [_samples(stitch, points, camera, group[k], frame) for k in spread]
            grey = np.concatenate(samples)
            if len(grey) >= _LEAST_POINTS:
                exposure = round(float(np.median([exposures[row] for row in group])), 4)
                level = round(trimmed_mean(grey), 3)
                found.append(LampCheck(camera=camera, light=light, exposure=exposure, grey=level, points=len(grey)))
    return tuple(found)


def is_comparable(lamp: LampCheck) -> bool:
    """Return whether the grey level of a brightness is neither darkness nor saturation."""
    return _DARKEST <= lamp.grey <= _BRIGHTEST


def grid_on_board(board: BoardType) -> Floats:
    """Return points (k, 2) in CAD units on a regular grid inside the board's outline.

    Points within one step of the edges are left out.
    """
    low, high = board.extent()
    step = math.sqrt(float(np.prod(high - low)) / _POINTS)
    if step <= 0:  # the board has no area
        return np.zeros((0, 2))
    columns, rows = (math.ceil(v / step) + 1 for v in (high - low).tolist())
    inside = np.zeros((rows, columns), dtype=np.uint8)
    outline = np.array(board.outline or (low, high), dtype=np.float64)
    if len(outline) == 2:
        (x0, y0), (x1, y1) = outline
        outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    cv2.fillPoly(inside, [np.rint((outline - low) / step).astype(np.int32)], 1)
    inside = np.asarray(cv2.erode(inside, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0))
    y, x = np.nonzero(inside)
    return np.asarray(low + np.stack([x, y], axis=1) * step)


def trimmed_mean(values: NDArray[Any]) -> float:
    """Return the mean of at least one value without the lowest and the highest tenth."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    cut = int(len(ordered) * _TRIM)
    return float(ordered[cut : len(ordered) - cut].mean())


def _groups(exposures: dict[int, float]) -> list[list[int]]:
    """Divide rows into groups of nearly equal product of exposure and gain, which `exposures` gives by row."""
    groups: list[list[int]] = []
    for row in sorted(exposures, key=exposures.__getitem__):
        if groups and math.log(exposures[row] / exposures[groups[-1][0]]) <= SAME_EXPOSURE:
            groups[-1].append(row)
        else:
            groups.append([row])
    return [sorted(group) for group in groups]


def _samples(stitch: Stitch, points: Floats, camera: int, row: int, frame: Frame) -> Floats:
    """Return the grey levels (k,), 0 … 255, of one frame at the points (…, 2) in tester coordinates that it shows."""
    image_from_tester, pixels = stitch.image_from_tester(camera, row), frame(camera, row)
    if image_from_tester is None or pixels is None:
        return np.zeros(0)
    # The distortion of the lens is left out: it moves the samples by the same few pixels in every run.
    x, y = np.rint(image_from_tester(points)).T
    height, width = pixels.shape[:2]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = pixels[y[inside].astype(np.intp), x[inside].astype(np.intp)]
    grey = np.asarray(values if values.ndim == 1 else values.mean(-1), dtype=np.float64)
    return grey if pixels.dtype == np.uint8 else grey * (FULL_SCALE / 65535)
