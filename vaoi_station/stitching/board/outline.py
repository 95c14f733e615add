"""The measured shift of the board's outline against the position that the fiducials predict.

All fiducials may be wrong together: look-alikes can have the right distances, and CAD data can be of another revision.
The edge of the board, a step of grey level between board and belt, is independent of them. It is searched across each
piece of the outline. A histogram over all pieces gives the shift of the board that most edges support. Near this shift
the edge of each piece is then measured to a fraction of a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.frame_visibility import FrameArrays
from vaoi_station.stitching.board.orientation import outline_polygons, straight_pieces, subsample_pieces
from vaoi_station.stitching.matching.scene import Scene

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
