"""Places of many patches against a template by least squares: shift, turn, gain and offset at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_ROUNDS = 5
_AT_ONCE = 128
"""Number of patches that are fitted at once, which bounds the memory."""
_LARGEST_STEP_PX = 1.5
"""Largest change of the place in one round; the equations hold for a pixel or so."""
_LARGEST_STEP_RAD = 0.08
_SMALL_STEP = (0.01, 0.01, 0.001)
"""Change of the pose, px and rad, after which a patch is not moved again."""


class Fit(NamedTuple):
    """How n patches fit a template."""

    pose: Floats
    """(n, 3) place of the part in the patch, px right and down of its centre, and its turn, rad, from x towards y."""
    gain: Floats
    offset: Floats
    misfit: Floats
    """(n,) mean of the squared differences, each as a multiple of its variance."""
    covariance: Floats
    """(n, 3, 3) of the pose for a misfit of 1 and independent pixels."""


class Template:
    """One picture of a part, the variance of its pixels, and the equations of its displacement."""

    def __init__(self, picture: Floats32, variance: Floats32, mask: Floats32) -> None:
        """Store a picture (h, w) with the variances of its pixels; `mask` is the weight of each, 0 to 1."""
        self.picture, self.variance, self.mask = picture, variance, mask
        h, w = picture.shape
        smooth = cv2.GaussianBlur(picture, (0, 0), 0.7)
        ty, tx = np.gradient(smooth)
        x, y = np.arange(w) - (w - 1) / 2, (np.arange(h) - (h - 1) / 2)[:, None]
        columns = [picture, np.ones_like(picture), -tx, -ty, y * tx - x * ty]
        design = np.stack([c.ravel() for c in columns], -1).astype(np.float64)
        weight = (mask / variance).ravel().astype(np.float64)
        self._weighted = design * weight[:, None]
        self._design = design
        self._total = float(mask.sum())
        self._weight = weight
        normal = self._weighted.T @ design
        normal[np.diag_indices(5)] *= 1 + 1e-9
        self._inverse = np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(5))

    def turned(self) -> Template:
        """Return the template turned by 180°."""
        return Template(*(np.ascontiguousarray(a[::-1, ::-1]) for a in (self.picture, self.variance, self.mask)))

    def quarter(self) -> Template:
        """Return the template turned by 90° counter-clockwise as seen."""
        return Template(*(np.ascontiguousarray(np.rot90(a)) for a in (self.picture, self.variance, self.mask)))

    def fit(self, patches: Floats32, start: Floats | None = None, rounds: int = _ROUNDS, limit_px: float = 1e9) -> Fit:
        """Fit patches (n, h, w), starting at poses (n, 3)."""
        if len(patches) > _AT_ONCE:
            starts = np.zeros((len(patches), 3)) if start is None else start
            cuts = range(_AT_ONCE, len(patches), _AT_ONCE)
            pieces = zip(np.split(patches, cuts), np.split(starts, cuts), strict=True)
            return joined([self.fit(p, at, rounds, limit_px) for p, at in pieces])
        pose = np.zeros((len(patches), 3)) if start is None else start.copy()
        left = np.arange(len(patches))
        for _ in range(rounds):
            at = pose[left]
            found = (warp(patches[left], at).reshape(len(left), -1) @ self._weighted) @ self._inverse
            gain = np.where(np.abs(found[:, 0]) < 0.05, 0.05, found[:, 0])
            step = found[:, 2:] / gain[:, None]
            step[:, :2] = np.clip(step[:, :2], -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
            step[:, 2] = np.clip(step[:, 2], -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD)
            c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
            at[:, 0] += c * step[:, 0] - s * step[:, 1]
            at[:, 1] += s * step[:, 0] + c * step[:, 1]
            at[:, 2] += step[:, 2]
            at[:, :2] = np.clip(at[:, :2], -limit_px, limit_px)
            pose[left] = at
            left = left[(np.abs(step) > _SMALL_STEP).any(1)]
            if not len(left):
                break
        return self.compare(patches, pose)

    def compare(self, patches: Floats32, pose: Floats) -> Fit:
        """Return how patches fit at given poses."""
        if len(patches) > _AT_ONCE:
            cuts = range(_AT_ONCE, len(patches), _AT_ONCE)
            pieces = zip(np.split(patches, cuts), np.split(pose, cuts), strict=True)
            return joined([self.compare(p, at) for p, at in pieces])
        n = len(patches)
        warped = warp(patches, pose).reshape(n, -1).astype(np.float64)
        two = self._weighted[:, :2]
        normal = two.T @ self._design[:, :2]
        # A template of one grey level, as of saturated or black bodies, shows no gain.
        normal[np.diag_indices(2)] *= 1 + 1e-9
        found = (warped @ two) @ np.linalg.inv(normal)
        rest = warped - found @ self._design[:, :2].T
        misfit = (rest * rest) @ self._weight / self._total
        gain = np.maximum(np.abs(found[:, 0]), 0.05)
        covariance = self._inverse[2:, 2:] / (gain**2)[:, None, None]
        return Fit(pose, found[:, 0], found[:, 1], misfit, covariance)


def joined(fits: Sequence[Fit]) -> Fit:
    """Return the fits of several stacks of patches as one."""
    return Fit(*(np.concatenate(values) for values in zip(*fits, strict=True)))


def warp(patches: Floats32, pose: Floats) -> Floats32:
    """Return patches (n, h, w) as they look when the parts at the poses are moved to the centre, upright."""
    n, h, w = patches.shape
    out = np.empty((n, h, w), np.float32)
    cx, cy = (w - 1) / 2, (h - 1) / 2
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    m = np.empty((n, 2, 3))
    m[:, 0, 0], m[:, 0, 1], m[:, 1, 0], m[:, 1, 1] = c, -s, s, c
    m[:, 0, 2] = cx + pose[:, 0] - c * cx + s * cy
    m[:, 1, 2] = cy + pose[:, 1] - s * cx - c * cy
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for k in range(n):
        cv2.warpAffine(patches[k], m[k], (w, h), out[k], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return out
