"""Search the motion of the board between two rows in the whole range that a belt can move, by correlation.

The reduced, high-passed frames of each camera are correlated at all shifts at once by Fourier transforms. The sums of
all cameras are added at the shifts that one motion on the conveyor's plane causes in each of them, so that the texture
of the whole row decides. The search yields several candidates; links of patches then show which of them is right.

A repeated pattern, such as a grid of LEDs, fits at several motions, and two cameras may find different ones although
they see one motion. `possible_motions` lists them, so that all cameras together are compared at each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.coarse_search import Small, best_peaks
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.link import row_reach_mm
from vaoi_station.stitching.matching.overlap import predict

Ints = NDArray[np.int64]
FASTEST = 1.5
"""Largest motion between two rows that is searched, as a share of the nominal motion. The smallest is 0."""
_ACROSS_MM = 2.0
"""Largest motion across the belt between two rows that is searched."""
_BACK_MM = 1.0
"""Range of the search against the belt's direction, mm.

A board at rest has its highest correlation at a motion of 0, and a maximum needs neighbours on both sides."""
_LEAST_OVERLAP = 0.12
"""Least share of a frame that the frames of both rows must show."""
_MIN_CONTRAST = 1.0
"""Contrast, rms of the high-passed grey levels, below which a frame counts as empty."""
_MIN_SCORE = 0.12
"""Smallest correlation of a candidate. It is low because components that lean reduce it; links decide later."""
_CANDIDATES = 5
SIMILAR = 0.75
"""Another motion fits as well if it has at least this share of the largest number of links."""
APART_MM = 0.5
"""Least difference between two motions. A smaller difference comes from components that lean."""
_STATIC_BOX, _STATIC_SHARE = 5, 0.4
"""Limits for texture that stands still, which is searched in squares of `_STATIC_BOX` reduced pixels.

Texture stands still if the squared difference of two frames, summed over a square, is less than `_STATIC_SHARE` times
the sum of their squares. This ratio is 1 for unrelated texture."""


class _Sums(NamedTuple):
    """Sums over the common pixels of two reduced frames, one for each shift between the frames; 0 without any."""

    products: Floats
    energy_a: Floats
    energy_b: Floats
    overlap: Floats
    """Number of common pixels, as a share of the frame."""


@dataclass(frozen=True, eq=False)
class _Reduced:
    """A pair of frames, and their reduced, high-passed copies that are correlated."""

    pair: FramePair
    a: Small
    b: Small


def candidate_motions(pairs: Sequence[FramePair], *, moving: bool = False) -> list[Floats]:
    """Return motions (2,) in mm of the board from rows p to q that fit their pictures, the most likely first.

    Args:
        pairs: the frames of rows p and q of each camera; `shift_mm` is the nominal motion, which gives direction and
            range.
        moving: whether to leave out texture that both frames show in the same place. Otherwise, texture that stands
            still beside the board may outweigh the board.
    """
    reduced = [_Reduced(pair, *(_moving(pair) if moving else (pair.a.coarse, pair.b.coarse))) for pair in pairs]
    textured = [one for one in reduced if min(_contrast(one.a), _contrast(one.b)) >= _MIN_CONTRAST]
    if not textured:
        return []
    nominal = textured[0].pair.shift_mm
    way = float(np.hypot(*nominal))
    if way <= 0:
        return []
    along = np.asarray(nominal) / way
    cell = max(one.pair.a.factor / one.pair.camera_a.px_per_mm for one in textured)
    # A whole number of samples, so that a motion of exactly 0 is one of them.
    u = np.arange(-math.ceil(_BACK_MM / cell) - 1, math.ceil(FASTEST * way / cell) + 2) * cell
    v = np.arange(-math.ceil(_ACROSS_MM / cell), math.ceil(_ACROSS_MM / cell) + 1) * cell
    across = np.array([-along[1], along[0]])
    motion = u[None, :, None] * along + v[:, None, None] * across
    each = [_correlated(one.a, one.b, _shifts(one.pair, motion)) for one in textured]
    products, energy_a, energy_b, overlap = (np.sum(sums, axis=0) for sums in zip(*each, strict=True))
    overlap /= len(textured)
    energy = np.sqrt(np.maximum(energy_a * energy_b, 0.0))
    whole = max(float(energy.max()), 1e-9)
    # At shifts at which the frames have hardly any texture in common, the correlation of noise is large.
    known = (overlap >= _LEAST_OVERLAP) & (energy > 0.02 * whole)
    score = np.where(known, products / np.maximum(energy, 1e-9 * whole), 0.0).astype(np.float32)
    peaks = best_peaks(np.ascontiguousarray(score), _CANDIDATES).tolist()
    return [(u[0] + x * cell) * along + (v[0] + y * cell) * across for s, x, y in peaks if s >= _MIN_SCORE]


def _contrast(coarse: Small) -> float:
    return math.sqrt(float(np.vdot(coarse, coarse)) / max(coarse.size, 1))


def _moving(pair: FramePair) -> tuple[Small, Small]:
    """Return the reduced copies of both frames of a pair, with 0 where both show the same texture."""
    a, b = pair.a.coarse, pair.b.coarse
    apart, both = (cv2.boxFilter(x, -1, (_STATIC_BOX, _STATIC_BOX)) for x in ((a - b) ** 2, a * a + b * b))
    moves = apart > _STATIC_SHARE * both
    return a * moves, b * moves


def _correlated(a: Small, b: Small, shift: Ints) -> _Sums:
    """Correlate two reduced frames at shifts (..., 2) from a to b, px, by Fourier transforms with zeros beside them."""
    (height, width), (rows, columns) = a.shape, b.shape
    # Half a frame of zeros would do for most shifts; a whole frame is enough for all of them. Single precision errs by
    # 1e-7 of the highest value.
    size = cv2.getOptimalDFTSize(height + rows), cv2.getOptimalDFTSize(width + columns)
    spectrum_a, spectrum_b = (cv2.dft(_padded(x, size), nonzeroRows=len(x)) for x in (a, b))
    product = cv2.mulSpectrums(spectrum_b, spectrum_a, 0, conjB=True)
    products = cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
    x, y = shift[..., 0], shift[..., 1]
    # What is common is a rectangle in each frame: sums over it need no transform.
    left, top = np.clip(-x, 0, width), np.clip(-y, 0, height)
    right, bottom = np.clip(columns - x, left, width), np.clip(rows - y, top, height)
    common = (right - left) * (bottom - top)
    energy_a = _sum_within(a, left, top, right, bottom)
    energy_b = np.where(common > 0, _sum_within(b, left + x, top + y, right + x, bottom + y), 0.0)
    return _Sums(np.where(common > 0, products[y % size[0], x % size[1]], 0.0), energy_a, energy_b, common / a.size)


def _padded(picture: Small, size: tuple[int, int]) -> Small:
    """Return a picture with zeros below and to the right of it."""
    out = np.zeros(size, np.float32)
    out[: picture.shape[0], : picture.shape[1]] = picture
    return out


def _sum_within(picture: Small, left: Ints, top: Ints, right: Ints, bottom: Ints) -> Floats:
    """Return the sums of squares of a picture in rectangles (...), whose right and lower ends are excluded."""
    sums = cv2.integral(picture * picture, sdepth=cv2.CV_64F)
    height, width = picture.shape
    (x0, x1), (y0, y1) = (np.clip(v, 0, width) for v in (left, right)), (np.clip(v, 0, height) for v in (top, bottom))
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0])


def _shifts(pair: FramePair, motion: Floats) -> Ints:
    """Convert motions (..., 2) of the board, mm, to the shifts of the reduced picture that they cause at its centre."""
    centre = np.array([pair.camera_a.center_px])
    # The shift of the picture is linear in the motion, except for a reduced pixel or two.
    by_x, by_y = (predict(centre, pair.camera_a, pair.camera_b, np.array(e))[0] for e in ((1.0, 0.0), (0.0, 1.0)))
    still = predict(centre, pair.camera_a, pair.camera_b, np.zeros(2))[0]
    jacobian = np.stack([by_x - still, by_y - still], 1)
    shift = np.rint((motion @ jacobian.T + (still - centre[0])) / pair.a.factor)
    return np.asarray(shift, dtype=np.int64)


def has_rival(links: Sequence[Links]) -> bool:
    """Return whether the coarse search of any camera found another shift that fits similarly well."""
    return any(e.rival_px is not None for e in links)


def possible_motions(links: Sequence[Links], cameras: Sequence[Camera], nominal_mm: Floats) -> list[Floats]:
    """Return the motions (2,) between two rows that one of the cameras allows, within the range of the coarse search.

    Args:
        links: the links between the two rows, one entry per camera.
        cameras: all cameras.
        nominal_mm: (2,) nominal motion between the two rows.
    """
    found: list[Floats] = []
    for e in links:
        if not len(e.a_px):
            continue
        camera = cameras[e.task.a[0]]
        own = np.median(camera.ground(e.b_px) - camera.ground(e.a_px), axis=0)
        found.append(own)
        if e.rival_px is not None and e.coarse_px is not None:
            middle = e.b_px.mean(axis=0)
            spacing = camera.ground(middle + np.subtract(e.rival_px, e.coarse_px)) - camera.ground(middle)
            found += [own + spacing, own - spacing]
    reach = row_reach_mm(nominal_mm) + APART_MM
    near = [motion for motion in found if (np.abs(motion - nominal_mm) <= reach).all()]
    return [one for n, one in enumerate(near) if all(np.hypot(*(one - other)) > APART_MM for other in near[:n])]
