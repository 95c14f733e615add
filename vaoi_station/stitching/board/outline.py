"""Separate the texture of the board from that of its surroundings: a carrier, or a dirty or textured belt.

Texture beside the board may move with it, stand still, or lie at another height, so that its links contradict those of
the board. The outline in the CAD data decides which links lie on the board. This is valid only where the pictures
confirm the outline: each side of it that is in view must show an edge where C puts this side, and no stronger edge near
by, but for those of components.

The orientation of the board: as expected, or turned by 180°. Two fiducials often fit both orientations.

If the fiducials do not decide the orientation, the pictures do (docs/decisions/0004). The outline is a step of grey
level between board and belt, and components have edges where the CAD data place them. The contrast of these edges is
measured for the board as placed and for the board turned by 180° on the same fiducials.

The measured shift of the board's outline against the position that the fiducials predict.

All fiducials may be wrong together: look-alikes can have the right distances, and CAD data can be of another revision.
The edge of the board, a step of grey level between board and belt, is independent of them. It is searched across each
piece of the outline. A histogram over all pieces gives the shift of the board that most edges support. Near this shift
the edge of each piece is then measured to a fraction of a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import Observations, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.geometry import FrameArrays
from vaoi_station.stitching.matching.frames import Scene

_PIECE_MM = 4.0
"""Length over which an edge is averaged, so that texture cancels and the edge stays."""
_SAMPLES, _DEPTHS = 10, 2
_NEAR_MM, _FAR_MM = 0.12, 0.45
"""Distances from an edge at which its two sides are compared."""
_APART_MM = 0.4
"""Edges of the two orientations that lie closer together than this are not compared."""
_CLEAR = {"outline": 1.5, "components": 2.5}
_LEAST_CONTRAST = {"outline": 5.0, "components": 10.0}
"""Least contrast, in grey levels, from which on the edges of a kind can decide the orientation.

In addition, the contrasts of the two orientations must differ by the factor in `_CLEAR`. Components are weaker evidence
than the outline, so their limits are higher."""
_FEWEST_PIECES, _MOST_PIECES = 6, 48
_LEAST_OUTLINE = 3.0
"""Least contrast of a visible outline, in grey levels. Noise alone gives less than 1."""


@dataclass(frozen=True)
class Orientation:
    """Median edge contrast in grey levels for both orientations, and the kind of edges on which it was measured."""

    evidence: str
    as_placed: float
    turned: float

    @property
    def contradicts(self) -> bool:
        """Whether the edges show that the board lies turned by 180°."""
        return _stands_out(self.evidence, self.turned, self.as_placed)

    @property
    def confirms(self) -> bool:
        """Whether the edges show that the board lies as placed."""
        return _stands_out(self.evidence, self.as_placed, self.turned)


def _stands_out(evidence: str, one: float, other: float) -> bool:
    return one > _CLEAR[evidence] * other and one > _LEAST_CONTRAST[evidence]


def compare_orientations(
    board_type: BoardType,
    placed: Floats,
    turned: Floats,
    scene: Scene,
    motion: Motion,
) -> Orientation | None:
    """Compare the edge contrast of the board as placed with that of the board turned by 180°.

    Args:
        board_type: board type, whose outline and components are used.
        placed: C as found, (3, 3) from CAD to tester coordinates.
        turned: C of the turned board on the same fiducials, (3, 3).
        scene: the cameras and frames.
        motion: motion of the rows.

    Returns:
        The first evidence that decides: the outline, else the components. If neither decides, the last evidence
        that was measured. None if there was nothing to compare.
    """
    best, frames = None, FrameArrays.of(scene, motion)
    for evidence, lines in (("outline", outline_polygons), ("components", _footprints)):
        pieces = straight_pieces(lines(board_type), board_type.mm_per_unit)
        if not len(pieces):
            continue
        apart = _apart(pieces, placed, turned)
        if apart.sum() < _FEWEST_PIECES:
            # A board that is symmetric about its fiducials has the same edges in both orientations.
            continue
        a = _contrasts(pieces[apart], placed, frames)
        b = _contrasts(pieces[apart], turned, frames)
        if min(len(a), len(b)) < _FEWEST_PIECES:
            continue
        # The median is used because texture and neighbouring components disturb single pieces.
        best = Orientation(evidence, float(np.median(a)), float(np.median(b)))
        if best.contradicts or best.confirms:
            return best
    return best


@dataclass(frozen=True)
class OutlineContrast:
    """Median contrast, in grey levels, along the board's outline as placed, and the number of measured pieces."""

    contrast: float
    pieces: int

    @property
    def visible(self) -> bool:
        """Whether the pictures show an edge where the board should end."""
        return self.contrast >= _LEAST_OUTLINE


def measure_outline_contrast(
    board_type: BoardType, placed: Floats, scene: Scene, motion: Motion
) -> OutlineContrast | None:
    """Measure the contrast along the outline where C (`placed`) puts it; None if too little is in view."""
    pieces = straight_pieces(outline_polygons(board_type), board_type.mm_per_unit)
    pieces = pieces[subsample_pieces(len(pieces))]
    steps = _contrasts(pieces, placed, FrameArrays.of(scene, motion)) if len(pieces) else np.zeros(0)
    return OutlineContrast(float(np.median(steps)), len(steps)) if len(steps) >= _FEWEST_PIECES else None


def subsample_pieces(pieces: int) -> NDArray[np.int_]:
    """Choose pieces of an outline: return the indices of all of them or, if they are many, of an even subset."""
    # 48 pieces give the position of the outline more precisely than boards are cut. More would only take more time.
    return np.unique(np.linspace(0, pieces - 1, min(pieces, _MOST_PIECES)).round().astype(np.int_))


def outline_polygons(board_type: BoardType) -> list[Floats]:
    """Return the outline as a list of polygons (k, 2) in CAD coordinates: one polygon, or none if it is unknown."""
    if board_type.outline is None:
        return []
    points = np.array(board_type.outline, dtype=np.float64)
    if len(points) == 2:
        low, high = points.min(0), points.max(0)
        points = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return [points]


def _footprints(board_type: BoardType) -> list[Floats]:
    return [board_type.footprint(c) for c in board_type.components]


def straight_pieces(polygons: list[Floats], mm_per_unit: float) -> Floats:
    """Cut closed polygons into k straight pieces of a few mm, (k, 2, 2) start and end; shorter edges are not cut."""
    if not polygons:
        return np.zeros((0, 2, 2))
    a, b = np.concatenate(polygons), np.concatenate([np.roll(p, -1, 0) for p in polygons])
    count = np.maximum((np.hypot(*(b - a).T) * mm_per_unit / _PIECE_MM).astype(int), 1)
    of, k = np.repeat(np.arange(len(a)), count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ends = np.stack([k, k + 1], -1) / count[of, None]
    return np.asarray(a[of, None] + ends[..., None] * (b - a)[of, None])


def _apart(pieces: Floats, placed: Floats, turned: Floats) -> NDArray[np.bool_]:
    """Return for each of k pieces whether it is far enough from all pieces of the other orientation to be compared."""
    a, b = apply(placed, pieces), apply(turned, pieces)
    along = a[:, 1] - a[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    middle_a, middle_b = a.mean(1), b.mean(1)
    offset = np.abs(((middle_b[None] - middle_a[:, None]) * normal[:, None]).sum(-1))
    length = np.abs(((middle_b[None] - middle_a[:, None]) * (normal[:, ::-1] * (1, -1))[:, None]).sum(-1))
    beside = length < _PIECE_MM
    nearest = np.where(beside, offset, np.inf).min(1)
    return np.asarray(nearest > _APART_MM)


def _contrasts(pieces: Floats, cad_matrix: Floats, frames: FrameArrays) -> Floats:
    """Measure the contrast in grey levels across each piece (k, 2, 2); pieces that no frame shows are left out."""
    board = apply(cad_matrix, pieces)
    number = frames.nearest(board.mean(1))
    px = frames.project(number, _both_sides(board))
    step = frames.read_samples(number, 1, lambda image, mine: _contrast(image, px[mine]))
    return np.asarray(step[np.isfinite(step)])


@compiled
def _contrast(image: NDArray[np.uint8], px: Floats) -> Floats:
    """Compute k contrasts (k, 1) from s sample points each, at raw pixels `px` (k, s, 2) of an image.

    A contrast is the absolute difference between the mean grey level of the first and of the second half of the points.
    It is NaN if one of the points lies outside the image.
    """
    h, w = image.shape
    count = px.shape[1]
    out = np.empty((len(px), 1))
    for k in range(len(px)):
        total = 0.0
        for s in range(count):
            x, y = px[k, s, 0], px[k, s, 1]
            if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
                total = np.nan
                break
            j, i = min(int(x), w - 2), min(int(y), h - 2)
            u, v = x - j, y - i
            above = image[i, j] * (1 - u) + image[i, j + 1] * u
            below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
            grey = above * (1 - v) + below * v
            total += grey if 2 * s < count else -grey
        out[k, 0] = 2 * abs(total) / count
    return out


def _both_sides(board: Floats) -> Floats:
    """Lay s sample points along both sides of each straight piece (k, 2, 2): (k, s, 2), all of one side first."""
    along = board[:, 1] - board[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    line = (board[:, :1] + t[None, :, None] * along[:, None])[:, None, None]
    off = np.array([[-1.0], [1.0]]) * np.linspace(_NEAR_MM, _FAR_MM, _DEPTHS)
    points = line + off[None, :, :, None, None] * normal[:, None, None, None]
    return np.asarray(points.reshape(len(board), -1, 2))


_STEP_MM, _REACH = 0.05, 70
"""Distance between samples across a piece of the outline, and number of samples on either side of it."""
_ALONG = 12
"""Number of samples along a piece that are averaged."""
_GAP, _SIDE = 1, 6
"""A step of grey level is the difference of two means of `_SIDE` samples, one on each side of the edge.

The samples begin `_GAP` samples away from the edge."""
_MOST_STEP = 40.0
"""Largest weight of a step in the histogram, in grey levels: one bright pad must not outweigh the board's edge."""
_LEAST_STEP = 6.0
_VOTE_MM, _VOTES = 0.1, 30
"""Distance between the shifts in the histogram, and number of shifts on either side of zero, along each axis."""
_MOVED_MM = 0.3
"""Displacement of a piece across itself from which it distinguishes a shift from none."""
_CLEARLY, _OPPOSED = 1.2, 0.7
"""Least ratio of the support for a shift to the support for none, over all such pieces, and over those of one side."""
_NEAR = 8
"""Half width, in samples, of the range in which the edge of a piece is searched around the most supported shift."""
_LEAST_PIECES = 6
_PRIOR = np.array([3.0, 3.0, 0.02, 0.2])
"""Prior standard deviations: shift x and y (mm), turn (rad), and excess size of the outline on all sides (mm).

The excess size is what a cutter leaves on all sides. With it as an unknown, one side alone determines the shift less
well than two opposite sides do."""
_PIECE_SIGMA_MM, _MACHINED_MM = 0.05, 0.1
"""Least scatter of single pieces of the outline, mm, and error of the cut outline as a whole against the copper (1
σ)."""
_KNEE, _ROUNDS = 2.0, 6
_LIMIT_MM, _TURN_LIMIT_MM, _LIMIT_SIGMAS = 0.5, 0.2, 4.0
"""Largest accepted shift, largest accepted turn (displacement of the board's ends), and both in standard deviations.

Cutting errors shift an outline more often than they turn it, so the limit of the turn is lower."""


@dataclass(frozen=True, eq=False)
class OutlineShift:
    """Shift and turn of the board's outline against the position that the fiducials predict, with uncertainty."""

    mm: Floats
    """(2,) shift in tester coordinates; 0 in a direction that no piece determines."""
    covariance: Floats
    """(2, 2) covariance of the shift, mm².

    In a direction in which no piece determines the shift, it is the covariance of the prior."""
    turn_rad: float
    turn_sigma_rad: float
    arm_mm: float
    """Distance from the centre of the pieces to the furthest piece."""
    pieces: int
    """Number of pieces of the outline that were used."""

    @property
    def excess_mm(self) -> float:
        """The part of the shift that neither cutting errors nor noise explain, as a length in mm.

        The shift is split along the principal axes of its covariance; only components that exceed the limits count.
        """
        sigma, way = np.linalg.eigh(self.covariance)
        along = np.abs(way.T @ self.mm)
        beyond = along > np.maximum(_LIMIT_MM, _LIMIT_SIGMAS * np.sqrt(sigma))
        return float(np.hypot(*(along * beyond)))

    @property
    def turned_mm(self) -> float:
        """Displacement of the board's ends by the turn of the outline, mm; 0 if noise or cutting may explain it."""
        turned = abs(self.turn_rad) * self.arm_mm
        return turned if turned > max(_TURN_LIMIT_MM, _LIMIT_SIGMAS * self.turn_sigma_rad * self.arm_mm) else 0.0

    @property
    def sigma_mm(self) -> Floats:
        """Standard deviations (2,) of the shift along tester x and y."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def measure_outline_shift(
    board_type: BoardType, cad_matrix: Floats, scene: Scene, motion: Motion
) -> OutlineShift | None:
    """Measure the shift of the outline against the position that C predicts.

    Args:
        board_type: board type, whose outline is used.
        cad_matrix: C from the fiducials, (3, 3) from CAD to tester coordinates.
        scene: the cameras and frames.
        motion: motion of the rows.

    Returns:
        The shift; None where too little of the outline shows an edge.
    """
    pieces = straight_pieces(outline_polygons(board_type), board_type.mm_per_unit)
    if len(pieces) < _LEAST_PIECES:
        return None
    board = apply(cad_matrix, pieces)
    normal, some = _outward(board), subsample_pieces(len(pieces))
    board, normal = board[some], normal[some]
    steps = _steps(_profiles(board, normal, scene, motion))
    shown = (steps >= _LEAST_STEP).any(1)
    if shown.sum() < _LEAST_PIECES:
        return None
    board, normal, steps = board[shown], normal[shown], steps[shown]
    return _fitted(board.mean(1), normal, steps, _voted(steps, normal))


def edge_profiles(board: Floats, scene: Scene, motion: Motion) -> tuple[float, Floats, Floats]:
    """Measure the steps of grey level across the k pieces (k, 2, 2), start and end in mm, of a closed polygon.

    Returns:
        The distance of samples in mm, the outward normals (k, 2), and the height of the step at each sample
        (k, samples), from inside to outside; 0 where no frame shows it.
    """
    normal = _outward(board)
    return _STEP_MM, normal, _steps(_profiles(board, normal, scene, motion))


def _outward(board: Floats) -> Floats:
    """Compute unit normals (k, 2), pointing away from the board, of the pieces (k, 2, 2) of a closed polygon."""
    along = board[:, 1] - board[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    # The sign of the area gives the direction in which the polygon runs, and so the side on which the board lies.
    area = (board[:, 0, 0] * board[:, 1, 1] - board[:, 1, 0] * board[:, 0, 1]).sum()
    return np.asarray(normal * np.sign(area))


def _profiles(board: Floats, normal: Floats, scene: Scene, motion: Motion) -> Floats:
    """Sample grey levels (k, samples) across each piece, averaged along the piece; NaN where no frame shows it."""
    frames = FrameArrays.of(scene, motion)
    number = frames.nearest(board.mean(1))
    reach, samples = _REACH * _STEP_MM * normal, 2 * _REACH + 1
    px = frames.project(number, np.stack([board[:, 0] - reach, board[:, 1] - reach, board[:, 0] + reach], 1))
    along, across = (px[:, 1] - px[:, 0]) / _ALONG, (px[:, 2] - px[:, 0]) / (samples - 1)
    start = px[:, 0] + along / 2
    return frames.read_samples(
        number, samples, lambda image, mine: _sampled(image, start[mine], along[mine], across[mine], _ALONG, samples)
    )


@compiled
def _sampled(
    image: NDArray[np.uint8],
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    across: NDArray[np.float64],
    count: int,
    samples: int,
) -> NDArray[np.float64]:
    """Sample a profile of averaged grey levels for each of k pieces: (k, samples).

    Sample s of piece k is the mean over `count` points, which begin at `start[k] + s · across[k]` and are `along[k]`
    apart (all in raw pixels). It is NaN if one of the points lies outside the image.
    """
    out = np.empty((len(start), samples))
    height, width = image.shape
    for k in range(len(start)):
        ax, ay = along[k, 0], along[k, 1]
        for s in range(samples):
            x, y = start[k, 0] + s * across[k, 0], start[k, 1] + s * across[k, 1]
            last_x, last_y = x + (count - 1) * ax, y + (count - 1) * ay
            if min(x, y, last_x, last_y) < 0 or max(x, last_x) >= width - 1 or max(y, last_y) >= height - 1:
                out[k, s] = np.nan
                continue
            total = 0.0
            for n in range(count):
                px, py = x + n * ax, y + n * ay
                j, i = int(px), int(py)
                u, v = px - j, py - i
                above = image[i, j] * (1 - u) + image[i, j + 1] * u
                below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
                total += above * (1 - v) + below * v
            out[k, s] = total / count
    return out


def _steps(profiles: Floats) -> Floats:
    """Compute the height of the grey-level step at each sample of k profiles, (k, samples); 0 where it is unknown."""
    samples = profiles.shape[1]
    at = np.arange(_GAP + _SIDE, samples - _GAP - _SIDE)
    # Prefix sums give the means on both sides of every sample in one pass.
    sums = np.concatenate([np.zeros((len(profiles), 1)), np.cumsum(np.nan_to_num(profiles), 1)], 1)
    blind = np.concatenate([np.zeros((len(profiles), 1)), np.cumsum(np.isnan(profiles), 1)], 1)
    far, near = at + _GAP + 1 + _SIDE, at - _GAP - _SIDE
    step = np.abs(sums[:, far] - sums[:, far - _SIDE] - sums[:, near + _SIDE] + sums[:, near]) / _SIDE
    out = np.zeros(profiles.shape)
    out[:, at] = np.where(blind[:, far] > blind[:, near], 0.0, step)
    return out


def _voted(steps: Floats, normal: Floats) -> Floats:
    """Find the shift (2,) of the board, mm, at which the sum of the steps over all pieces is largest.

    The fiducials predict a shift near zero. Another one must have clearly more support, and no side of the board may
    contradict it: a row of bright pads inside the board is an edge as well, but on one side only.
    """
    tries = np.arange(-_VOTES, _VOTES + 1) * _VOTE_MM
    weight, grid = np.minimum(steps, _MOST_STEP), np.asarray(tries, np.float64)
    votes = _vote_histogram(weight, normal, grid, _STEP_MM)
    i, j = np.unravel_index(int(votes.argmax()), votes.shape)
    shift = np.array([tries[j], tries[i]])
    near = np.abs(tries) <= _LIMIT_MM + _VOTE_MM / 2
    if near[i] and near[j]:
        return shift
    # Only pieces that the shift moves across themselves distinguish it from none.
    across = normal @ shift
    for some, least in (
        (np.abs(across) > _MOVED_MM, _CLEARLY),
        (across > _MOVED_MM, _OPPOSED),
        (across < -_MOVED_MM, _OPPOSED),
    ):
        support = _vote_histogram(weight[some], normal[some], grid, _STEP_MM)
        if support[i, j] < least * support[np.ix_(near, near)].max():
            row, column = np.unravel_index(int(votes[np.ix_(near, near)].argmax()), (near.sum(), near.sum()))
            return np.array([tries[near][column], tries[near][row]])
    return shift


@compiled
def _vote_histogram(
    steps: NDArray[np.float64], normal: NDArray[np.float64], tries: NDArray[np.float64], step_mm: float
) -> NDArray[np.float64]:
    """Sum the steps of all pieces for every shift: (t, t), shifts along y by shifts along x.

    Args:
        steps: (k, samples) step heights across each piece, `step_mm` apart.
        normal: (k, 2) outward normals of the pieces.
        tries: (t,) shifts in mm that are tried along each axis.
        step_mm: distance of samples.
    """
    count, samples = len(tries), steps.shape[1]
    # Samples are added at the ends of the line, so that no shift reads beyond it and the inner loop needs no test.
    out, far = np.zeros((count, count)), int(2 * np.abs(tries).max() / step_mm) + 1
    line = np.zeros(samples + 2 * far)
    for k in range(len(steps)):
        line[far : far + samples] = steps[k]
        across = normal[k, 0] / step_mm
        for i in range(count):
            first, to = far + samples // 2 + normal[k, 1] * tries[i] / step_mm + 0.5, out[i]
            for j in range(count):
                to[j] += line[int(first + across * tries[j])]
    return out


def _fitted(middle: Floats, normal: Floats, steps: Floats, shift: Floats) -> OutlineShift | None:
    """Estimate shift, turn and excess size of the outline by robust least squares over the edges near `shift`.

    Args:
        middle: (k, 2) centres of the pieces, mm in tester coordinates.
        normal: (k, 2) outward normals of the pieces.
        steps: (k, samples) step heights across each piece.
        shift: (2,) mm, initial value of the shift.
    """
    offset, height = _edges(steps, normal @ shift / _STEP_MM + _REACH)
    use = height >= _LEAST_STEP
    if use.sum() < _LEAST_PIECES:
        return None
    offset, n, arm = (offset[use] - _REACH) * _STEP_MM, normal[use], middle[use] - middle.mean(0)
    j = np.column_stack([n, arm[:, 0] * n[:, 1] - arm[:, 1] * n[:, 0], np.ones(len(n))])
    weight, solved, scatter = np.ones(len(n)), np.zeros(4), _PIECE_SIGMA_MM
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv((j * (weight / scatter**2)[:, None]).T @ j + np.diag(_PRIOR**-2.0))
        solved = inverse @ (j.T @ (weight / scatter**2 * offset))
        residual = offset - j @ solved
        # 1.4826: from the median absolute deviation to the standard deviation of a normal distribution.
        scatter = max(1.4826 * float(np.median(np.abs(residual))), _PIECE_SIGMA_MM)
        weight = huber_weights(residual / scatter, _KNEE)
    # A cutting error moves all pieces together, so the residuals of the fit do not show it.
    covariance, turn_sigma = inverse[:2, :2] + _MACHINED_MM**2 * np.eye(2), float(np.sqrt(inverse[2, 2]))
    return OutlineShift(solved[:2], covariance, float(solved[2]), turn_sigma, float(np.hypot(*arm.T).max()), len(n))


def _edges(steps: Floats, expected: Floats) -> tuple[Floats, Floats]:
    """Locate the edge of each piece near `expected` (k,), in samples; return positions (k,) and step heights (k,).

    A parabola through the highest step and its two neighbours gives the position to a fraction of a sample.
    """
    near = np.clip(np.rint(expected).astype(int)[:, None] + np.arange(-_NEAR, _NEAR + 1), 1, steps.shape[1] - 2)
    rows = np.arange(len(steps))
    at = near[rows, np.take_along_axis(steps, near, 1).argmax(1)]
    before, top, after = steps[rows, at - 1], steps[rows, at], steps[rows, at + 1]
    bend = before - 2 * top + after
    off = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    return at + np.clip(off, -0.5, 0.5), top


MOST_BESIDE = 0.03
"""Largest share of links beside the board that need not be left out: the robust loss copes with them."""
_MOST_AT_EDGE = 0.1
"""Largest share of links outside the outline in one pair of frames that need not be left out."""
_MARGIN_MM = 1.0
"""Links outside the outline by more than this lie beside the board; errors of C and of cutting are smaller."""
HALF_PATCH_PX = 12.0
"""Links on the board that are nearer to the outline than this measure a mixture of board and surroundings."""
_EDGE_NEAR_MM = 0.5
"""Largest distance between a side's edge in the pictures and its position by C, due to cutting and fiducials."""
_QUANTILE = 0.25
"""The step of grey level of a side is this quantile of the steps of its pieces.

The edge of a board runs along all pieces of a side; a row of pads runs along only some of them. Where components hide
more than the other pieces, nothing is known of a line."""
_LEAST_EDGE = 4.0
"""Smallest step of grey level at the edge of a side."""
_STANDS_OUT = 1.15
"""A side of the outline stands out only if its step at the edge exceeds other steps by this factor.

The other steps are those more than twice `_EDGE_NEAR_MM` away from the expected edge."""
_PART_MM = 0.35
"""Distance from a component, with solder and silkscreen, up to which a step of grey level contains its edge.

A connector along a side shows a stronger edge than the board, which is no reason to doubt the outline."""
_FEWEST_OF_SIDE = 2
"""Least number of pieces of a side in view; with fewer, the side is not checked."""


class LeftOut(NamedTuple):
    """The links that were left out because they lie beside the board."""

    share: float
    """Share of these links in all links between rows."""
    confirmed: bool
    """Whether the pictures show the edges of the board at its outline."""
    links: Observations
    """These links."""


def beside(plane: BoardPlane, c: Floats, board_mm: Floats, margin_mm: float = _MARGIN_MM) -> NDArray[np.bool_]:
    """Return which board points (k, 2), mm, lie outside the outline by more than a margin; none without an outline.

    With a negative margin, points inside the outline and nearer to it than the margin count as outside too.
    """
    return beside_in_cad(plane.board_type, apply(np.linalg.inv(plane.matrix(c)), board_mm), margin_mm)


def beside_in_cad(board_type: BoardType, cad: Floats, margin_mm: float) -> NDArray[np.bool_]:
    """Return the same as `beside` for points (k, 2) in CAD coordinates."""
    polygons = outline_polygons(board_type)
    # A board type with fixture marks describes its carrier: links there are meant to be used.
    if not polygons or board_type.fixture_marks:
        return np.zeros(len(cad), np.bool_)
    ends = polygons[0]
    inside, near = np.zeros(len(cad), np.bool_), np.full(len(cad), np.inf)
    x, y = cad.T
    for (ax, ay), (bx, by) in zip(ends, np.roll(ends, -1, 0), strict=True):
        way = np.array([bx - ax, by - ay])
        crosses = (ay > y) != (by > y)
        # A ray to the right crosses the outline of a simple polygon an odd number of times from inside.
        inside ^= crosses & (x < ax + (y - ay) * way[0] / (way[1] if way[1] else np.inf))
        along = np.clip(((x - ax) * way[0] + (y - ay) * way[1]) / max(float(way @ way), 1e-12), 0, 1)
        near = np.minimum(near, np.hypot(x - ax - along * way[0], y - ay - along * way[1]))
    depth = np.where(inside, near, -near) * board_type.mm_per_unit
    return np.asarray(depth < -margin_mm)


def shares_beside(plane: BoardPlane, c: Floats, links: Observations, motion: Motion) -> tuple[float, float]:
    """Return the share of the links between rows that lie beside the board, and that of the links between cameras."""
    off, between = beside(plane, c, motion.board(links.p, links.a_mm)), links.p == links.q
    rows, seams = off[~between], off[between]
    return (float(rows.mean()) if len(rows) else 0.0), (float(seams.mean()) if len(seams) else 0.0)


def links_on_board(
    plane: BoardPlane, c: Floats, links: Observations, motion: Motion, px_per_mm: float
) -> NDArray[np.int_]:
    """Return the indices of the links whose patches lie wholly on the board."""
    return np.flatnonzero(~beside(plane, c, motion.board(links.p, links.a_mm), -HALF_PATCH_PX / px_per_mm))


def without_links_beside(
    plane: BoardPlane, problem: Problem, motion: Motion, c: Floats, confirmed: Callable[[], bool]
) -> Problem:
    """Return a problem without those links beside a board at position `c` that may be left out in any case.

    Carrier, belt or bed lie at another height than the board. Links between cameras there would bend its estimated
    surface, or show a displaced camera (seed 100346). They say nothing about the motion of the rows, so that they need
    not be confirmed by an edge. Between rows, links outside the outline are left out if they are more than
    `_MOST_AT_EDGE` of a pair of frames, and if the pictures confirm the outline (`confirmed`): along the edge of the
    board, patches are found where the texture of a bed is (seed 102577: nine of them outvoted two on a component).
    """
    links = problem.links
    off = beside(plane, c, motion.board(links.p, links.a_mm), 0.0)
    share = np.bincount(links.group, off) / np.maximum(np.bincount(links.group), 1)
    between = links.p == links.q
    at_edge = off & ~between & (share[links.group] > _MOST_AT_EDGE)
    # The outline is checked only where it matters: that takes longer than all else here.
    off &= between | (at_edge if at_edge.any() and confirmed() else between)
    return problem.select(np.flatnonzero(~off)) if off.any() else problem


def outline_confirmed(plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion) -> bool:
    """Return whether every side of the outline that is in view shows its edge where C (`cad_matrix`) puts it."""
    pieces = straight_pieces(outline_polygons(plane.board_type), plane.board_type.mm_per_unit)
    if not len(pieces):
        return False
    board = apply(cad_matrix, pieces[subsample_pieces(len(pieces))])
    step_mm, normal, steps = edge_profiles(board, scene, motion)
    offset = (np.arange(steps.shape[1]) - steps.shape[1] // 2) * step_mm
    at_edge, seen = np.abs(offset) <= _EDGE_NEAR_MM, (steps > 0).mean(1) > 0.5
    others = other_steps(plane, cad_matrix, board, normal[:, None] * offset[:, None], steps, 2 * _EDGE_NEAR_MM)
    side = np.rint(np.arctan2(normal[:, 1], normal[:, 0]) / (np.pi / 4)).astype(int) % 8
    sides = 0
    for one in np.unique(side[seen]).tolist():
        mine = np.flatnonzero(seen & (side == one))
        if len(mine) < _FEWEST_OF_SIDE:
            continue
        if strongest_line(steps[mine][:, at_edge]) < max(_LEAST_EDGE, _STANDS_OUT * strongest_line(others[mine])):
            return False
        sides += 1
    return sides > 0


def other_steps(
    plane: BoardPlane, cad_matrix: Floats, board_mm: Floats, offset_mm: Floats, steps: Floats, beyond_mm: float
) -> Floats:
    """Return the steps across pieces of the outline without those at its edge and at the edges of components, as NaN.

    Args:
        plane: plane of the board type.
        cad_matrix: C, (3, 3).
        board_mm: (k, 2, 2) start and end of the pieces, tester coordinates.
        offset_mm: (k, samples, 2) displacements at which the steps were measured.
        steps: (k, samples) the steps of grey level.
        beyond_mm: steps up to this distance from a piece belong to its edge.
    """
    away = np.hypot(offset_mm[..., 0], offset_mm[..., 1]) > beyond_mm
    return np.where(away & ~_shows_part(plane, cad_matrix, board_mm, offset_mm), steps, np.nan)


def strongest_line(steps: Floats) -> float:
    """Return the strongest step of a line along pieces of a side, from their steps (k, samples); NaN is unknown.

    Between components that hide most of a line, a single pad or marking would count as a line: such lines are left out.
    """
    shown = np.isfinite(steps).mean(0) >= _QUANTILE
    return float(_quantile_of_known(steps[:, shown]).max(initial=0.0))


def _quantile_of_known(values: Floats) -> Floats:
    """Return the `_QUANTILE` of every column (n,) of values (k, n) without those that are NaN; each has one at least.

    `numpy.nanquantile` gives the same, but takes more than a hundred times as long.
    """
    if not values.size:
        return np.zeros(values.shape[1])
    at = _QUANTILE * (np.isfinite(values).sum(0) - 1)
    # NaN is sorted behind all numbers.
    ascending, low, column = np.sort(values, axis=0), np.floor(at).astype(np.int_), np.arange(values.shape[1])
    below, above = ascending[low, column], ascending[np.ceil(at).astype(np.int_), column]
    return np.asarray(below + (at - low) * (above - below))


def _shows_part(plane: BoardPlane, cad_matrix: Floats, board_mm: Floats, offset_mm: Floats) -> NDArray[np.bool_]:
    """Return whether pieces of the outline (k, 2, 2), displaced by (k, samples, 2), reach a component, (k, samples)."""
    along = np.stack([board_mm[:, 0], board_mm.mean(1), board_mm[:, 1]], 1)
    points = along[:, :, None] + offset_mm[:, None]
    cad_from_board = np.asarray(np.linalg.inv(cad_matrix), np.float64)
    found = plane.components.widened(_PART_MM).find(cad_from_board, points.reshape(-1, 2))
    return np.asarray((found >= 0).reshape(points.shape[:3]).any(1))
