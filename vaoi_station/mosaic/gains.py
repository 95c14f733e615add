"""Gains that make frames agree where they overlap: one per frame, and a smooth field and dark level of the cameras.

Lamps flicker, lenses darken the corners, and the dark level is rarely measured. All of it shows in the overlaps: the
same place of the board has different grey levels in two frames. The model of a block of 32 px in frame f of camera i is

    log(value − dark / sensitivity) = log(radiance of the place) + g_f + φ(position in the frame) · c_i

with a polynomial φ of fourth degree. Differences of pairs of frames do not contain the radiance, and are solved for g,
c and the dark level by robust least squares. Priors keep what overlaps do not determine at its expected value: with
flat fields, corrections of the field are small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.homographies import between, of_part
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.frames import TakenFrame
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.reduction import Reduced, reduced, shrunk
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.noise import pixels_at_limit
from vaoi_station.steps import Steps

Floats32 = NDArray[np.float32]
Copies = MutableMapping[tuple[int, int], Reduced]
"""Frames (camera, row), reduced by `COARSE_PX`."""
ReadFrame = Callable[[int, int], NDArray[Any] | None]
"""Returns the pixels of a frame (camera, row), (h, w) or (h, w, 3) of 8 or 16 bits; None if it is missing."""

COARSE_PX = 8
"""Side of a pixel of the survey, in pixels of the mosaic at the resolution of the cameras."""
BLOCK = 4
"""Side of the blocks whose means are compared, in pixels of the survey."""
_LEAST_COARSE = 2
"""Least width and height of the copy of a frame, in pixels of the survey."""


@dataclass(frozen=True, eq=False)
class SurveyedFrame:
    """The small copy of one frame, with its place on the survey's grid."""

    taken: TakenFrame
    x0: int
    """Column of the copy's first pixel on the survey's grid, a multiple of `BLOCK`."""
    y0: int
    values: Floats32
    """(h, w) radiance: grey levels (8 bit) per µs at gain 1; NaN beside the frame and where it is saturated."""
    raw_from_coarse: Floats
    """(3, 3) matrix from pixels of the survey's grid to raw pixels of the frame."""


class FieldCache:
    """Flat fields and dark levels of the cameras of a run, reduced to the resolution of the survey."""

    def __init__(self, fields: FlatFields) -> None:
        self._fields = fields
        self._reduced: dict[tuple[int, str | None, int], tuple[Floats32 | float, Floats32 | float]] = {}

    def reduced(self, camera: int, light: str | None, factor: int) -> tuple[Floats32 | float, Floats32 | float]:
        """Return flat field and dark level of a camera, as means over blocks of `factor` px, or as one value."""
        key = camera, light, factor
        if key not in self._reduced:
            maps = self._fields.maps(camera, light)
            flat = 1.0 if maps.flat is None else np.maximum(shrunk(maps.flat, factor), np.float32(0.02))
            dark = maps.dark if isinstance(maps.dark, float) else shrunk(maps.dark, factor)
            self._reduced[key] = flat, dark
        return self._reduced[key]


def survey(
    frames: Sequence[TakenFrame],
    read: ReadFrame,
    projector: FrameIndex,
    grid: MosaicGrid,
    fields: FieldCache,
    copies: Copies | None = None,
) -> Iterator[SurveyedFrame]:
    """Read every frame once, and yield the small copies of those that show the board."""
    for taken in frames:
        box = projector.seen_box(taken.camera, taken.row, *grid.place)
        step = COARSE_PX * BLOCK
        x0, y0 = box[0] // step * BLOCK, box[1] // step * BLOCK
        w, h = -(-box[2] // COARSE_PX) - x0, -(-box[3] // COARSE_PX) - y0
        if min(w, h) < _LEAST_COARSE or min(box[2] - box[0], box[3] - box[1]) < COARSE_PX:
            continue
        pixels = read(taken.camera, taken.row)
        if pixels is None:
            continue
        matrix = projector.matrix(taken.camera, taken.row, grid.cad_from_mosaic, box)
        raw_from_coarse = between(matrix, 1, COARSE_PX)
        copy = reduced(Reduced(pixels, pixels), COARSE_PX)
        whole = pixels.shape[0] // COARSE_PX, pixels.shape[1] // COARSE_PX
        small = _radiance(copy, whole, taken, fields)
        values = cv2.warpPerspective(
            small,
            of_part(between(matrix, COARSE_PX, COARSE_PX), x0, y0),
            (w, h),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        if copies is not None:
            copies[taken.camera, taken.row] = copy
        yield SurveyedFrame(taken, x0, y0, np.asarray(values, np.float32), raw_from_coarse)


def _radiance(copy: Reduced, size: tuple[int, int], taken: TakenFrame, fields: FieldCache) -> Floats32:
    """Return the radiance of a frame from its copy that is reduced by `COARSE_PX`; NaN where blocks are saturated.

    `size` is the number of rows and columns of whole blocks. What is left beside them is cut off.
    """
    h, w = size
    means, largest = (part[:h, :w] for part in copy)
    full = 255 if means.dtype == np.uint8 else 65535
    flat, dark = fields.reduced(taken.camera, taken.light, COARSE_PX)
    grey = means if means.ndim == 2 else np.asarray(cv2.cvtColor(means, cv2.COLOR_BGR2GRAY))
    value = (grey.astype(np.float32) * np.float32(255 / full) - dark) / flat
    value /= np.float32(taken.sensitivity)
    value[pixels_at_limit(largest)] = np.nan
    return np.asarray(value, np.float32)


_DEGREE = 4
_POWERS = tuple((p, d - p) for d in range(_DEGREE + 1) for p in range(d + 1))
"""Exponents of the terms of the field; the first is the constant of the camera."""
_TERMS = len(_POWERS) + 2
"""Number of terms: the polynomial, and the two terms of a field that falls off equally to all sides."""
_FURTHEST = 1.05
"""Limit of the places at which a field is evaluated; the borders of the frame are at −1 and 1."""
_FLICKER = 0.02
"""Expected deviation of the gain of one frame (logarithm): lamps flicker by a percent or two."""
_PRIOR = {False: (0.1, 0.03, 0.015, 0.3), True: (0.03, 0.02, 0.01, 0.01)}
"""Expected size of the constant, linear, higher and centric terms of a camera's field, without and with flat fields.

Neighbouring cameras share a narrow seam only, so that the field along a row of cameras is hardly measured. It is that
across, which many rows measure, as far as the overlaps do not say otherwise."""
_DARK_PRIOR = {False: 2.0, True: 0.02}
"""Expected error of the dark level, 8-bit grey levels, without and with flat fields."""
_NOISE = 0.05
"""Standard deviation of the mean of a block by noise, 8-bit grey levels."""
_MODEL_ERROR = 0.008
"""Relative deviation of a block between frames by texture, glare and interpolation."""
_LEAST_GREY = 5.0
"""Blocks darker than this, in 8-bit grey levels above darkness, are not used: noise is cut off at zero there."""
_LEAST_PER_PAIR, _MOST_PER_FRAME = 64, 40_000
"""Number of blocks that are compared of each pair of frames: the larger the board, the fewer, to bound the memory."""
_ITERATIONS = 6
_PAIRS_PER_STEP = 64
_TUKEY = 4.0
"""Residual in standard deviations from which a block (glare, a body seen from two sides) has no weight."""


@dataclass(frozen=True, eq=False)
class Gains:
    """The estimated gains of the frames of one mosaic."""

    frame: dict[tuple[int, int], float]
    """Logarithm of the gain of each frame (camera, row); 0 for most."""
    field: dict[int, Floats]
    """Coefficients of the polynomial of each camera."""
    dark: float
    """Correction of the dark level, 8-bit grey levels."""

    def log_field(self, camera: int, eye: Camera, raw_px: Floats) -> Floats:
        """Return the logarithm of the camera's field at raw pixels (..., 2); 0 if it is not known."""
        return np.asarray(_terms(eye, raw_px) @ self.field.get(camera, np.zeros(_TERMS)))


class _Blocks(NamedTuple):
    """Mean values of the blocks of one surveyed frame."""

    x0: int
    y0: int
    values: Floats
    """(h, w) radiance; NaN where a block is not wholly seen."""
    terms: Floats
    """(h, w, k) terms of the field."""


class _Pair(NamedTuple):
    """The n blocks that two frames have in common."""

    unknowns: NDArray[np.int64]
    """(2 k + 3,) numbers of the unknowns: gains of both frames, coefficients of both cameras, dark level."""
    sensitivity: Floats
    """(2,)"""
    values: Floats
    """(n, 2) radiance in both."""
    terms: NDArray[np.float32]
    """(n, 2, k) terms of the field in both."""


def estimate_gains(surveyed: Sequence[SurveyedFrame], cameras: Sequence[Camera], *, calibrated: bool) -> Steps[Gains]:
    """Estimate the gains of surveyed frames from their overlaps. `calibrated`: flat fields were used."""
    keys = [(s.taken.camera, s.taken.row) for s in surveyed]
    used = sorted({camera for camera, _ in keys})
    n, k = len(keys), _TERMS
    first = {camera: n + k * index for index, camera in enumerate(used)}
    blocks: list[_Blocks] = []
    for s in surveyed:
        blocks.append(_blocks_of(s, cameras[s.taken.camera]))
        yield
    pairs = yield from _pairs(surveyed, blocks, first)
    prior = _precisions(n, len(used), calibrated)
    solution, spread = np.zeros(len(prior)), np.inf
    for _ in range(_ITERATIONS if pairs else 0):
        normal, right, residuals = np.diag(prior), np.zeros(len(prior)), []
        for number, pair in enumerate(pairs):
            residuals.append(_add_equations(pair, solution, _TUKEY * spread, normal, right))
            if number % _PAIRS_PER_STEP == 0:
                yield
        solution = np.asarray(np.linalg.solve(normal, right), np.float64)
        spread = max(1.4826 * float(np.median(np.abs(np.concatenate(residuals)))), 0.3)
    frame = dict(zip(keys, solution[:n].tolist(), strict=True))
    field = {camera: solution[first[camera] : first[camera] + k] for camera in used}
    return Gains(frame, field, float(solution[-1]))


def _add_equations(pair: _Pair, solution: Floats, furthest: float, normal: Floats, right: Floats) -> Floats:
    """Add the equations of a pair, one for each block, to the normal equations; return their residuals.

    The equation of a block is the difference log a − log b, at the present dark level. Residuals are in standard
    deviations; a block beyond `furthest` has no weight.
    """
    at, sensitivity, measured, terms = pair
    dark, k = solution[-1], terms.shape[2]
    values = np.maximum(measured - dark / sensitivity, 0.25 * measured)
    row = np.empty((len(values), len(at)))
    row[:, 0], row[:, 1] = 1, -1
    row[:, 2 : 2 + k], row[:, 2 + k : -1] = terms[:, 0], -terms[:, 1]
    model = row[:, :-1] @ solution[at[:-1]]
    # The derivative by the dark level is that of smoothed values: measured ones have the errors of the difference, and
    # would pull the dark level down.
    middle, half = np.sqrt(values.prod(1)), np.exp(model / 2)
    row[:, -1] = 1 / (middle * half * sensitivity[0]) - half / (middle * sensitivity[1])
    variance = _MODEL_ERROR**2 + np.square(_NOISE / (values * sensitivity)).sum(1)
    difference = np.log(values[:, 0] / values[:, 1])
    residuals = (difference - model) / np.sqrt(variance)
    weight = np.square(np.maximum(1 - np.square(residuals / furthest), 0)) / variance
    weighted = row.T * weight
    # The cameras may be the same: entries of equal unknowns are summed.
    np.add.at(right, at, weighted @ (difference + row[:, -1] * dark))
    np.add.at(normal, (at[:, None], at), weighted @ row)
    return np.asarray(residuals)


def _pairs(surveyed: Sequence[SurveyedFrame], blocks: Sequence[_Blocks], first: dict[int, int]) -> Steps[list[_Pair]]:
    """Collect the common blocks of all pairs of frames that have some."""
    most = max(_LEAST_PER_PAIR, _MOST_PER_FRAME // max(len(blocks), 1))
    sizes = [b.values.shape for b in blocks]
    boxes = np.array([(b.x0, b.y0, b.x0 + w, b.y0 + h) for b, (h, w) in zip(blocks, sizes, strict=True)]).reshape(-1, 4)
    terms, last = np.arange(_TERMS), len(blocks) + _TERMS * len(first)
    pairs: list[_Pair] = []
    for n, a in enumerate(blocks):
        low, high = np.maximum(boxes[:n, :2], boxes[n, :2]), np.minimum(boxes[:n, 2:], boxes[n, 2:])
        for m in np.flatnonzero((low < high).all(1)).tolist():
            b, (x0, y0), (x1, y1) = blocks[m], low[m].tolist(), high[m].tolist()
            in_a = np.s_[y0 - a.y0 : y1 - a.y0, x0 - a.x0 : x1 - a.x0]
            in_b = np.s_[y0 - b.y0 : y1 - b.y0, x0 - b.x0 : x1 - b.x0]
            va, vb = a.values[in_a], b.values[in_b]
            taken = surveyed[n].taken, surveyed[m].taken
            sensitivity = np.array([t.sensitivity for t in taken])
            chosen = np.flatnonzero((va * sensitivity[0] > _LEAST_GREY) & (vb * sensitivity[1] > _LEAST_GREY))
            if len(chosen):
                v, u = np.unravel_index(chosen[:: -(-len(chosen) // most)], va.shape)
                unknowns = np.concatenate([[n, m], *(first[t.camera] + terms for t in taken), [last]])
                values = np.stack([va[v, u], vb[v, u]], -1)
                pairs.append(
                    _Pair(unknowns, sensitivity, values, np.stack([a.terms[in_a][v, u], b.terms[in_b][v, u]], 1))
                )
        yield
    return pairs


def _blocks_of(frame: SurveyedFrame, eye: Camera) -> _Blocks:
    h, w = (n // BLOCK for n in frame.values.shape)
    cut = frame.values[: h * BLOCK, : w * BLOCK].astype(np.float64)
    values = cut.reshape(h, BLOCK, w, BLOCK).mean((1, 3))
    y, x = np.mgrid[:h, :w]
    middle = (BLOCK - 1) / 2
    coarse = np.stack([x * BLOCK + middle + frame.x0, y * BLOCK + middle + frame.y0], -1)
    return _Blocks(frame.x0 // BLOCK, frame.y0 // BLOCK, values, _terms(eye, apply(frame.raw_from_coarse, coarse)))


def _terms(eye: Camera, raw_px: NDArray[np.float64]) -> Floats:
    """Return the terms (..., k) of the field at raw pixels (..., 2)."""
    u = np.clip(raw_px[..., 0] / (eye.width_px - 1) * 2 - 1, -_FURTHEST, _FURTHEST)
    v = np.clip(raw_px[..., 1] / (eye.height_px - 1) * 2 - 1, -_FURTHEST, _FURTHEST)
    centric = (u * u + v * v) / 2
    found = np.empty((*u.shape, _TERMS), np.float32)
    # Products of products: a power takes ten times as long.
    along, across = (np.cumprod([np.ones_like(w), *[w] * _DEGREE], 0) for w in (u, v))
    for n, (p, q) in enumerate(_POWERS):
        found[..., n] = along[p] * across[q]
    found[..., -2], found[..., -1] = centric, centric * centric
    return found


def _precisions(frames: int, cameras: int, calibrated: bool) -> Floats:
    """Return the inverse variances of the priors of all unknowns."""
    constant, linear, higher, centric = _PRIOR[calibrated]
    field = [constant if p + q == 0 else linear if p + q == 1 else higher for p, q in _POWERS] + [centric, centric]
    sigma = np.concatenate([np.full(frames, _FLICKER), np.tile(field, cameras), [_DARK_PRIOR[calibrated]]])
    return np.asarray(sigma**-2.0)
