"""Probabilities and standard deviations of measures, from what the pictures say.

PRESENT, HEIGHT_ALONE, the slope of ALIKE, PLACE and TURN were fitted by `python -m tests.cases.parts_constants DIR` to
painted boards whose truth is known (docs/measured.md); the others were chosen by looking at such boards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PRESENT = (19.438, -6.951, 6.715, 0.744, 0.505, -0.412, 8.009)
"""Presence: constant, unlikeness, the same beyond `_KNEE`, evidence of the height, alone and with a strip, unlikeness
beyond `_KNEE` once more where heights say little, and by how much less unlike another kind it looks.

Absent parts counted twice: a tester rather looks at one more part than probes one that is not there."""
HEIGHT_ALONE = (2.397, 1.422, 1.164)
"""Presence by the height alone: constant, evidence of the height, alone and with a strip."""
ALIKE = (8.75, -3.09)
"""Likeness to good boards: constant, unlikeness."""
PLACE = (2.8, 0.03, 0.08, 0.01, 1.5)
"""Standard deviation of a place: multiple of that by noise, pixels, pixels per unlikeness (logarithm), and share of the
displacement, as pads that stay are seen beside the part; factor for parts that were found by searching."""
TURN = (2.2, 0.003, 0.01, 1.75, 1.6)
"""Standard deviation of a turn: the same, with pixels at the end of the part; the share is of the turn, by pixels of
half the length."""
SPREAD_MM, SPREAD_DEG = 0.02, 0.25
"""Spread of the places of good parts that is assumed for the mean place of those taught."""
TURNED = 6.0
"""Slope of the probability of an orientation over the share of the expected difference."""
_KNEE, _MOST, _OTHER = 3.0, 7.0, 2.5
"""Logarithms of unlikeness: where its slope changes, the largest one, and that from which on another kind says nothing.

Bare pads are some 40 times as unlike other kinds as good ones are, exchanged parts some 4 times."""
_HEIGHT_SD, _ABSENT_SD = 0.12, 0.1
"""Standard deviation of a height beyond its own, as a share of the expected one: of a part, of the bare board."""
_UNTAUGHT = ((1.0, 0.15), (0.65, 0.33))
"""Height by parallax of a part that was not taught and its standard deviation, alone and with a strip around it."""
_BOARD = (0.0, -0.08)
"""Height by parallax of the bare board, alone and with a strip."""
FAINT = 2.0
"""Evidence of heights below which only the look decides; without good boards, nothing."""
_ALONE = 2.0
"""Factor on the standard deviation of the height of the body alone: faint texture next to pads misleads it."""
_MOST_HEIGHT = 8.0


def height_evidence(measured: Floats, sigma: Floats, taught: Floats) -> Floats:
    """Return the logarithms (n, 2) of how much more probable heights are of a part than of the bare board.

    Heights (n, 2) are shares of the expected ones: of the body, and of the body with a strip around it. `taught` are
    those of good boards. The result is 0 where a height is not known.
    """
    out = np.zeros(measured.shape)
    for k, (mean, sd) in enumerate(_UNTAUGHT):
        known = np.isfinite(taught[:, k])
        expected = np.where(known, taught[:, k], mean)
        noise = (_ALONE if k == 0 else 1.0) * sigma[:, k]
        present = noise**2 + np.where(known, _HEIGHT_SD**2, sd**2)
        absent = noise**2 + _ABSENT_SD**2
        with np.errstate(invalid="ignore"):
            far, near = (measured[:, k] - _BOARD[k]) ** 2 / absent, (measured[:, k] - expected) ** 2 / present
            found = (far - near + np.log(absent / present)) / 2
        out[:, k] = np.nan_to_num(np.clip(found, -_MOST_HEIGHT, _MOST_HEIGHT))
    return out


def presence_features(unlike: Floats, other: Floats, heights: Floats) -> Floats:
    """Return the features (n, 7) of which presence is a logistic function; `heights` (n, 2) is `height_evidence`."""
    own, others = (np.log(np.maximum(v, 1e-3)) for v in (unlike, other))
    own = np.clip(own, 0, _MOST)
    beyond = np.maximum(own - _KNEE, 0)
    faint = np.abs(heights).sum(1) < FAINT
    explained = np.clip(np.minimum(own, _OTHER) - others, 0, _OTHER)
    return np.column_stack([np.ones(len(own)), own, beyond, heights, beyond * faint, explained])


def presence(unlike: Floats, other: Floats, heights: Floats) -> Floats:
    """Return the probability that a part is there."""
    return logistic(presence_features(unlike, other, heights) @ np.array(PRESENT))


def presence_by_height(heights: Floats) -> Floats:
    """Return the probability that a part is there by its height alone."""
    return logistic(HEIGHT_ALONE[0] + heights @ np.array(HEIGHT_ALONE[1:]))


def alike(unlike: Floats) -> Floats:
    """Return the probability that a part is of the kind that good boards have there."""
    return logistic(ALIKE[0] + ALIKE[1] * np.clip(np.log(np.maximum(unlike, 1e-3)), 0, _MOST))


def orientation(ratio: Floats, marks: Floats, visible: float) -> Floats:
    """Return the probabilities (n, 4) of the quarters of a turn; 0 where an orientation is not known.

    Args:
        ratio: (n, 4) logarithm of the misfit by orientation, less that of the upright part.
        marks: (n, 4) the same of a part that lies upright.
        visible: least value of `marks` with which orientations are distinguished.
    """
    told = np.nan_to_num(marks) > visible
    told[:, 0] = True
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(told, np.nan_to_num(ratio) / np.where(told & (marks > 0), marks, 1.0), np.inf)
    share[:, 0] = 0.0
    odds = np.exp(-TURNED * np.clip(share, -3, 3)) * told
    return np.asarray(odds / odds.sum(1, keepdims=True))


def logistic(value: Floats) -> Floats:
    """Return 1 / (1 + exp(−value))."""
    return np.asarray(1 / (1 + np.exp(-np.clip(value, -30, 30))))


class Scale(NamedTuple):
    """What the standard deviations of n parts depend on beside noise."""

    px_per_mm: Floats
    """Resolution of the patches."""
    length_px: Floats
    """Length of the part in its patch."""
    samples: NDArray[np.int_]
    """Number of good parts that make the template, whose mean place is taken for that of the CAD data."""
    unlike: Floats
    searched: NDArray[np.bool_]
    moved_mm: Floats
    """Distance from the place of the CAD data."""
    turned_deg: Floats
    """Turn against the CAD data."""


def sigmas(noise_mm: Floats, noise_deg: Floats, scale: Scale) -> tuple[Floats, Floats]:
    """Return the standard deviations of places, mm, and of turns, degrees, of those by noise alone."""
    unit = 2 / scale.length_px
    of_turn = _sigma(noise_deg, np.degrees(unit), unit * scale.turned_deg, SPREAD_DEG, scale, TURN)
    return _sigma(noise_mm, 1 / scale.px_per_mm, scale.moved_mm, SPREAD_MM, scale, PLACE), of_turn


def _sigma(
    noise: Floats, unit: Floats, off: Floats, spread: float, scale: Scale, constants: tuple[float, ...]
) -> Floats:
    """Return the standard deviations of one measure; `unit` is that of a pixel."""
    by_noise, px, by_odd, by_off, searched = constants
    odd = np.log(np.maximum(scale.unlike, 1.0))
    own = (by_noise * noise) ** 2 + unit**2 * (px**2 + (by_odd * odd) ** 2) + (by_off * off) ** 2
    factor = np.where(scale.searched, searched, 1.0)
    return np.asarray(np.sqrt(own * factor**2 + spread**2 / np.maximum(scale.samples, 1)))
