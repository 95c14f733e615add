"""Gains that make frames agree where they overlap: one per frame, and a smooth field and dark level of the cameras.

Lamps flicker, lenses darken the corners, and the dark level is rarely measured. All of it shows in the overlaps: the
same place of the board has different grey levels in two frames. The model of a block of 32 px in frame f of camera i is

    log(value − dark / sensitivity) = log(radiance of the place) + g_f + φ(position in the frame) · c_i

with a polynomial φ of fourth degree. Differences of pairs of frames do not contain the radiance, and are solved for g,
c and the dark level by robust least squares. Priors keep what overlaps do not determine at its expected value: with
flat fields, corrections of the field are small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.survey import BLOCK, SurveyedFrame

_DEGREE = 4
_POWERS = tuple((p, d - p) for d in range(_DEGREE + 1) for p in range(d + 1))
"""Exponents of the terms of the field; the first is the constant of the camera."""
_TERMS = len(_POWERS) + 2
"""Number of terms: the polynomial, and the two terms of a field that falls off equally to all sides."""
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
        """Return the logarithm of the camera's field at raw pixels (..., 2)."""
        if camera not in self.field:
            return np.zeros(raw_px.shape[:-1])
        return np.asarray(_terms(eye, raw_px) @ self.field[camera])


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Mean values of the blocks of one surveyed frame."""

    x0: int
    y0: int
    values: Floats
    """(h, w) radiance; NaN where a block is not wholly seen."""
    terms: Floats
    """(h, w, k) terms of the field."""


def estimate_gains(surveyed: Sequence[SurveyedFrame], cameras: Sequence[Camera], *, calibrated: bool) -> Gains:
    """Estimate the gains of surveyed frames from their overlaps. `calibrated`: flat fields were used."""
    keys = [(s.taken.camera, s.taken.row) for s in surveyed]
    used = sorted({camera for camera, _ in keys})
    blocks = [_blocks_of(s, cameras[s.taken.camera]) for s in surveyed]
    pairs = list(_pairs(surveyed, blocks))
    n, k = len(keys), _TERMS
    first = {camera: n + k * index for index, camera in enumerate(used)}
    size = n + k * len(used) + 1
    prior = _precisions(n, len(used), calibrated)
    solution, spread = np.zeros(size), np.inf
    for _ in range(_ITERATIONS):
        normal, right = np.diag(prior), np.zeros(size)
        residuals = []
        for pair in pairs:
            columns = [np.arange(k) + first[camera] for camera in pair.cameras]
            at = np.concatenate([pair.frames, *columns, [size - 1]])
            design, target, sigma = pair.linearised(solution[at])
            rest = (target - design @ solution[at] + design[:, -1] * solution[-1]) / sigma
            weight = np.clip(1 - (rest / (_TUKEY * spread)) ** 2, 0, None) ** 2 / sigma**2
            residuals.append(rest)
            weighted = design * weight[:, None]
            # Cameras may be the same: entries of equal unknowns are summed.
            np.add.at(normal, (at[:, None], at[None]), weighted.T @ design)
            np.add.at(right, at, weighted.T @ (target + design[:, -1] * solution[-1]))
        solution = np.asarray(np.linalg.solve(normal, right), np.float64)
        if residuals:
            spread = max(1.4826 * float(np.median(np.abs(np.concatenate(residuals)))), 0.3)
    frame = dict(zip(keys, solution[:n].tolist(), strict=True))
    field = {camera: solution[first[camera] : first[camera] + k] for camera in used}
    return Gains(frame, field, float(solution[-1]))


@dataclass(frozen=True, eq=False)
class _Pair:
    """The common blocks of two frames."""

    frames: tuple[int, int]
    cameras: tuple[int, int]
    value_a: Floats
    value_b: Floats
    terms_a: Floats
    terms_b: Floats
    sensitivity_a: float
    sensitivity_b: float

    def linearised(self, solution: Floats) -> tuple[Floats, Floats, Floats]:
        """Return design matrix, target and standard deviations of the differences log a − log b.

        The unknowns are the gains of a and b, the coefficients of both cameras and the dark level; `solution` are
        their present values. The target is that at the present dark level.
        """
        dark = solution[-1]
        a = np.maximum(self.value_a - dark / self.sensitivity_a, 0.25 * self.value_a)
        b = np.maximum(self.value_b - dark / self.sensitivity_b, 0.25 * self.value_b)
        grey_a, grey_b = a * self.sensitivity_a, b * self.sensitivity_b
        design = np.column_stack([np.ones(len(a)), -np.ones(len(a)), self.terms_a, -self.terms_b, np.zeros(len(a))])
        # The derivative by the dark level is that of smoothed values: measured ones have the errors of the target, and
        # would pull the dark level down.
        middle, half = np.sqrt(a * b), np.exp(design @ solution / 2)
        design[:, -1] = 1 / (middle * half * self.sensitivity_a) - half / (middle * self.sensitivity_b)
        sigma = np.sqrt(_MODEL_ERROR**2 + (_NOISE / grey_a) ** 2 + (_NOISE / grey_b) ** 2)
        return design, np.log(a) - np.log(b), sigma


def _pairs(surveyed: Sequence[SurveyedFrame], blocks: Sequence[_Blocks]) -> Iterator[_Pair]:
    """Yield the common blocks of all pairs of frames that have some."""
    most = max(_LEAST_PER_PAIR, _MOST_PER_FRAME // max(len(blocks), 1))
    for n, a in enumerate(blocks):
        for m in range(n):
            b = blocks[m]
            x0, y0 = max(a.x0, b.x0), max(a.y0, b.y0)
            x1 = min(a.x0 + a.values.shape[1], b.x0 + b.values.shape[1])
            y1 = min(a.y0 + a.values.shape[0], b.y0 + b.values.shape[0])
            if x1 <= x0 or y1 <= y0:
                continue
            in_a = np.s_[y0 - a.y0 : y1 - a.y0, x0 - a.x0 : x1 - a.x0]
            in_b = np.s_[y0 - b.y0 : y1 - b.y0, x0 - b.x0 : x1 - b.x0]
            sa, sb = surveyed[n].taken.sensitivity, surveyed[m].taken.sensitivity
            va, vb = a.values[in_a], b.values[in_b]
            common = (va * sa > _LEAST_GREY) & (vb * sb > _LEAST_GREY)
            chosen = np.flatnonzero(common)
            if len(chosen):
                chosen = chosen[:: -(-len(chosen) // most)]
                terms_a, terms_b = (t.reshape(-1, _TERMS)[chosen] for t in (a.terms[in_a], b.terms[in_b]))
                yield _Pair(
                    (n, m),
                    (surveyed[n].taken.camera, surveyed[m].taken.camera),
                    va.ravel()[chosen],
                    vb.ravel()[chosen],
                    terms_a,
                    terms_b,
                    sa,
                    sb,
                )


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
    u = np.clip(raw_px[..., 0] / (eye.width_px - 1) * 2 - 1, -1.05, 1.05)
    v = np.clip(raw_px[..., 1] / (eye.height_px - 1) * 2 - 1, -1.05, 1.05)
    centric = (u * u + v * v) / 2
    return np.stack([*(u**p * v**q for p, q in _POWERS), centric, centric * centric], -1).astype(np.float32)


def _precisions(frames: int, cameras: int, calibrated: bool) -> Floats:
    """Return the inverse variances of the priors of all unknowns."""
    constant, linear, higher, centric = _PRIOR[calibrated]
    field = [constant if p + q == 0 else linear if p + q == 1 else higher for p, q in _POWERS] + [centric, centric]
    sigma = np.concatenate([np.full(frames, _FLICKER), np.tile(field, cameras), [_DARK_PRIOR[calibrated]]])
    return np.asarray(sigma**-2.0)
