"""Estimate the noise floor of measurements: by how much they scatter beyond their stated noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints, median_noise_px
from vaoi_station.stitching.adjustment.problem import Problem

_MEDIAN = 2 * math.log(2)
"""Median of the χ² distribution with two degrees of freedom."""
_HALVINGS = 12
"""Number of bisections. With limits of 0.003 and 5 px, the result is uncertain by 0.2 %."""

_LIMITS_PX, _FIRST_PX = (0.003, 5.0), 0.05
"""Smallest and largest noise floor of links, px, and a usual value, used until the noise floor is estimated."""
_AT_LIMIT, _DISPLACED_PX = 0.99, 60.0
"""Two values for the noise floor between two cameras whose displacements are unknowns.
The noise floor counts as limited if it exceeds this share of its upper limit. It is then estimated with the second
value as upper limit. A turn of a camera by 0.1° causes a displacement of some 35 px, which is below this limit: with a
lower one, all links of the camera would be rejected before its displacement is estimated."""
_SAMPLE, _MIN_LINKS, _SEAM_LINKS = 4000, 20, 6
"""The noise floor of a kind of link is estimated from about `_SAMPLE` links, which gives it to about 2 %.
It needs at least `_MIN_LINKS` links; `_SEAM_LINKS` between two cameras can only raise it. Otherwise all links of a
displaced camera would be rejected where the overlap shows few."""
_FEW = 60
"""With fewer links between rows on the bare board, more than half of them may be false ones at the board's edges.

The noise floor is then at most that of all links between rows, which is never too small: heights scatter."""
_SEAM_PX, _NARROWING = 0.04, 3.0
"""Upper limit of the noise floor between two cameras if a surface is estimated.
It is `_SEAM_PX`, or the scatter divided by `_NARROWING`, whichever is larger. So the surface follows those links that
agree with one another. Links on tall components beside the seam become outliers."""


class NoiseFloors:
    """The noise floors of the links of a problem, one for each kind of link.

    Each pair of neighbouring cameras is a kind of its own. A lifted board or a displaced camera at first causes a large
    scatter, but only in the links between the cameras concerned. All other links keep their weight until the surface
    and the displacements explain this scatter.
    """

    def __init__(self, problem: Problem, kind: Ints, seams: int, raised: NDArray[np.bool_]) -> None:
        """Choose the links from which the noise floors are estimated.

        Args:
            problem: the problem of the adjustment.
            kind: (k,) kind of each link: 0 between rows, 1 … `seams` between two cameras in one row, and the last one
                between rows of different lights.
            seams: number of kinds of links between two cameras.
            raised: (k,) whether each link may lie above the board although no component is under it.
        """
        self._problem, self._seams = problem, seams
        bare = [_bare(problem, kind == k, raised) for k in range(1 + seams + 1)]
        self._samples = [_sample(at) for at in bare]
        """Indices of sampled links on the bare board, by kind. The model explains these links: what is left is noise.
        """
        rows = np.flatnonzero(kind == 0)
        self._all_rows = _sample(rows if len(bare[0]) < _FEW else rows[:0])
        """Indices of sampled links between rows, if those on the bare board are few."""
        self.noise_px = np.array([median_noise_px(problem.links, at) for at in self._samples])
        """Median image noise of the sampled links, by kind."""
        self.px = np.full(1 + seams + 1, _FIRST_PX)
        """The noise floors, by kind."""

    def update(self, residual: Floats, *, displaceable: bool) -> None:
        """Estimate the noise floors from residuals (k, 2), mm.

        `displaceable` says whether the displacements of the cameras are unknowns.
        """
        links, (low, high) = self._problem.links, _LIMITS_PX
        for kind, at in enumerate(self._samples):
            seam = 0 < kind <= self._seams
            if len(at) < (_SEAM_LINKS if seam else _MIN_LINKS):
                continue
            scatter = noise_floor(residual, links.noise_mm2, links.px_per_mm, at, low, high)
            if seam and displaceable and scatter > _AT_LIMIT * high:
                scatter = noise_floor(residual, links.noise_mm2, links.px_per_mm, at, high, _DISPLACED_PX)
            if seam and self._problem.surface is not None:
                scatter = max(min(scatter, _SEAM_PX), scatter / _NARROWING)
            if kind == 0 and len(self._all_rows) >= _MIN_LINKS:
                every = noise_floor(residual, links.noise_mm2, links.px_per_mm, self._all_rows, low, high)
                scatter = min(scatter, every)
            self.px[kind] = scatter if len(at) >= _MIN_LINKS else max(scatter, _FIRST_PX)


def _bare(problem: Problem, of_kind: NDArray[np.bool_], raised: NDArray[np.bool_]) -> Ints:
    """Return indices of the links of a kind on the bare board; near components only if the others are too few."""
    bare = (problem.component < 0) & of_kind
    surely = np.flatnonzero(bare & ~raised)
    return surely if len(surely) >= _MIN_LINKS else np.flatnonzero(bare)


def _sample(at: Ints) -> Ints:
    """Return about `_SAMPLE` of the indices."""
    # A contiguous copy: for a slice with a step, Numba would compile another variant while a board waits.
    return np.ascontiguousarray(at[:: max(len(at) // _SAMPLE, 1)])


@compiled
def noise_floor(residual: Floats, noise: Floats, per_unit: Floats, use: Ints, low: float, high: float) -> float:
    """Return the noise floor: the standard deviation per axis that must be added to the stated noise.

    With the noise floor, the median of the squared normalised residuals is that of χ² with two degrees of freedom. As a
    median is used, up to half of the measurements may be outliers.

    Args:
        residual: (k, 2) residuals.
        noise: (k, 2, 2) covariances of the stated noise.
        per_unit: (k,) units of the noise floor per unit of the residuals, for example px per mm.
        use: indices of the measurements that are used.
        low: lower limit of the noise floor.
        high: upper limit of the noise floor.
    """
    left = use.copy()
    surely, undecided = 0, len(use)
    for _ in range(_HALVINGS):
        # bisection in the logarithm: the limits are three orders of magnitude apart
        middle, above = math.sqrt(low * high), 0
        # Measurements above the median of χ² are moved to the front. The next bisection then tests only one of the two
        # parts, so that all bisections together take about as long as two passes over the measurements.
        for at in range(undecided):
            n = left[at]
            x, y, more = residual[n, 0], residual[n, 1], (middle / per_unit[n]) ** 2
            a, b, d = noise[n, 0, 0] + more, noise[n, 0, 1], noise[n, 1, 1] + more
            if d * x * x - 2 * b * x * y + a * y * y > _MEDIAN * (a * d - b * b):
                left[at], left[above] = left[above], n
                above += 1
        if 2 * (surely + above) > len(use):
            low, undecided = middle, above
        else:
            high, surely = middle, surely + above
            undecided -= above
            for at in range(undecided):
                left[at] = left[above + at]
    return math.sqrt(low * high)
