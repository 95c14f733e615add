"""What the board's outline shows in the pictures: orientation, position, and which texture is the board's own.

The outline is a step of grey level between board and belt, independent of the fiducials. Two fiducials often fit a
board turned by 180°: the contrast of outline and footprints decides (docs/decisions/0004). All fiducials may be wrong
together, as look-alikes with the right distances: the edge is searched across each piece of the outline, a histogram
over all pieces gives the shift that most edges support, and near it the edges are measured. Texture of a carrier or a
belt may contradict the board's: the outline separates both where each side in view shows an edge in its place and no
stronger one near by, but for those of components.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import Observations, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import Scene

_PIECE_MM = 4.0
"""Length over which an edge is averaged, so that texture cancels and the edge stays."""
_SAMPLES, _DEPTHS, _NEAR_MM, _FAR_MM = 10, 2, 0.12, 0.45
"""Points along a piece and across each of its sides, and distances from the edge at which the sides are compared."""
_APART_MM = 0.4
"""Edges of the two orientations that lie closer together than this are not compared."""
_CLEAR, _LEAST_CONTRAST = {"outline": 1.5, "components": 2.5}, {"outline": 5.0, "components": 10.0}
"""Least ratio of the contrasts of the two orientations, and least contrast in grey levels, from which on the edges of a
kind can decide the orientation."""
_LEAST_PIECES, _MOST_PIECES = 6, 48
_LEAST_OUTLINE = 3.0
"""Least contrast of a visible outline, in grey levels. Noise alone gives less than 1."""
_STEP_MM, _REACH, _ALONG = 0.05, 70, 12
"""Distance of samples across a piece, their number on either side of it, and number of samples averaged along it."""
_GAP, _SIDE = 1, 6
"""A step of grey level is the difference of the means of `_SIDE` samples on each side, `_GAP` away from the edge."""
_MOST_STEP, _LEAST_STEP = 40.0, 6.0
"""Largest weight of a step in the histogram, in grey levels: one bright pad must not outweigh the board's edge."""
_VOTE_MM, _VOTES = 0.1, 30
"""Distance between the shifts in the histogram, and number of shifts on either side of zero, along each axis."""
_MOVED_MM, _CLEARLY, _OPPOSED = 0.3, 1.2, 0.7
"""Displacement of a piece across itself from which it distinguishes a shift from none; least ratio of the support for a
shift to the support for none, over all such pieces, and over those of one side."""
_NEAR = 8
"""Half width, in samples, of the range in which the edge of a piece is searched around the most supported shift."""
_PRIOR = np.array([3.0, 3.0, 0.02, 0.2])
"""Prior standard deviations: shift x and y (mm), turn (rad), and what a cutter leaves on all sides (mm)."""
_PIECE_SIGMA_MM, _MACHINED_MM = 0.05, 0.1
"""Least scatter of pieces of the outline, mm, and error of the cut outline as a whole against the copper (1 σ)."""
_KNEE, _ROUNDS = 2.0, 6
_LIMIT_MM, _TURN_LIMIT_MM, _LIMIT_SIGMAS = 0.5, 0.2, 4.0
"""Largest accepted shift, largest accepted turn (displacement of the board's ends), and both in standard deviations."""
MOST_BESIDE, _MOST_AT_EDGE = 0.03, 0.1
"""Largest share of links beside the board, and of those outside the outline in one pair of frames, that need not be
left out: the robust loss copes with them."""
_MARGIN_MM = 1.0
"""Links outside the outline by more than this lie beside the board; errors of C and of cutting are smaller."""
HALF_PATCH_PX = 12.0
"""Links on the board that are nearer to the outline than this measure a mixture of board and surroundings."""
_EDGE_NEAR_MM = 0.5
"""Largest distance between a side's edge in the pictures and its position by C, due to cutting and fiducials."""
_QUANTILE = 0.25
"""The step of grey level of a side is this quantile of the steps of its pieces: a row of pads runs along only some."""
_LEAST_EDGE, _STANDS_OUT = 4.0, 1.15
"""Least step of grey level at the edge of a side, and least ratio to the steps more than `2 · _EDGE_NEAR_MM` away."""
_PART_MM = 0.35
"""Distance from a component, with solder and silkscreen, up to which a step of grey level contains its edge."""
_PIECES_OF_SIDE = 2
"""Least number of pieces of a side in view; with fewer, the side is not checked."""


def outline_polygons(board_type: BoardType) -> list[Floats]:
    """Return the outline as a list of polygons (k, 2) in CAD coordinates: one polygon, or none if it is unknown."""
    if board_type.outline is None:
        return []
    points = np.array(board_type.outline, dtype=np.float64)
    if len(points) == 2:
        (x0, y0), (x1, y1) = points.min(0), points.max(0)
        points = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return [points]


def straight_pieces(polygons: list[Floats], mm_per_unit: float) -> Floats:
    """Cut closed polygons into k straight pieces of a few mm, (k, 2, 2) start and end; shorter edges are not cut."""
    if not polygons:
        return np.zeros((0, 2, 2))
    a, b = np.concatenate(polygons), np.concatenate([np.roll(p, -1, 0) for p in polygons])
    count = np.maximum((np.hypot(*(b - a).T) * mm_per_unit / _PIECE_MM).astype(int), 1)
    of, k = np.repeat(np.arange(len(a)), count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ends = np.stack([k, k + 1], -1) / count[of, None]
    return np.asarray(a[of, None] + ends[..., None] * (b - a)[of, None])


def outline_pieces(board_type: BoardType) -> Floats:
    """Return the pieces (k, 2, 2) of the outline in CAD coordinates; if they are many, an even subset of them."""
    pieces = straight_pieces(outline_polygons(board_type), board_type.mm_per_unit)
    return pieces[np.unique(np.linspace(0, len(pieces) - 1, min(len(pieces), _MOST_PIECES)).round().astype(np.int_))]


def _left_normals(board: Floats) -> Floats:
    """Return the unit normals (k, 2) of pieces (k, 2, 2), to the left of their direction."""
    along = board[:, 1] - board[:, 0]
    return np.asarray(np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None])


@dataclass(frozen=True)
class Orientation:
    """Median edge contrast in grey levels for both orientations, and the kind of edges on which it was measured."""

    evidence: str
    as_placed: float
    turned: float

    @property
    def contradicts(self) -> bool:
        """Whether the edges show that the board lies turned by 180°."""
        return self._stands_out(self.turned, self.as_placed)

    @property
    def confirms(self) -> bool:
        """Whether the edges show that the board lies as placed."""
        return self._stands_out(self.as_placed, self.turned)

    def _stands_out(self, one: float, other: float) -> bool:
        return one > _CLEAR[self.evidence] * other and one > _LEAST_CONTRAST[self.evidence]


def compare_orientations(
    board_type: BoardType, placed: Floats, turned: Floats, scene: Scene, motion: Motion
) -> Orientation | None:
    """Compare the edge contrast of the board as placed with that of the board turned by 180°, by two C (3, 3)."""
    best, frames = None, scene.index(motion.rows_from_tester)
    footprints = [board_type.footprint(c) for c in board_type.components]
    for evidence, polygons in (("outline", outline_polygons(board_type)), ("components", footprints)):
        pieces = straight_pieces(polygons, board_type.mm_per_unit)
        # A board that is symmetric about its fiducials has the same edges in both orientations.
        apart = pieces[_apart(pieces, placed, turned)] if len(pieces) else pieces
        if len(apart) < _LEAST_PIECES:
            continue
        a, b = _contrasts(apart, placed, frames), _contrasts(apart, turned, frames)
        if min(len(a), len(b)) < _LEAST_PIECES:
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
    pieces = outline_pieces(board_type)
    steps = _contrasts(pieces, placed, scene.index(motion.rows_from_tester)) if len(pieces) else np.zeros(0)
    return OutlineContrast(float(np.median(steps)), len(steps)) if len(steps) >= _LEAST_PIECES else None


def _apart(pieces: Floats, placed: Floats, turned: Floats) -> NDArray[np.bool_]:
    a, b = apply(placed, pieces), apply(turned, pieces)
    normal, way = _left_normals(a), b.mean(1)[None] - a.mean(1)[:, None]
    offset = np.abs((way * normal[:, None]).sum(-1))
    length = np.abs((way * (normal[:, ::-1] * (1, -1))[:, None]).sum(-1))
    return np.asarray(np.where(length < _PIECE_MM, offset, np.inf).min(1) > _APART_MM)


def _contrasts(pieces: Floats, cad_matrix: Floats, frames: FrameIndex) -> Floats:
    board = apply(cad_matrix, pieces)
    number, normal = frames.nearest(board.mean(1)), _left_normals(board)
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    line = (board[:, :1] + t[None, :, None] * (board[:, 1:] - board[:, :1]))[:, None, None]
    off = np.array([[-1.0], [1.0]]) * np.linspace(_NEAR_MM, _FAR_MM, _DEPTHS)
    points = line + off[None, :, :, None, None] * normal[:, None, None, None]
    grey = frames.grey(number, frames.project(number, points.reshape(len(board), -1, 2)))
    step = np.abs(np.subtract(*(side.mean(1) for side in np.split(grey, 2, axis=1))))
    return np.asarray(step[np.isfinite(step)])


@dataclass(frozen=True, eq=False)
class OutlineShift:
    """Shift and turn of the board's outline against the position that the fiducials predict, with uncertainty."""

    mm: Floats
    """(2,) shift in tester coordinates; 0 in a direction that no piece determines."""
    covariance: Floats
    """(2, 2) covariance of the shift, mm²; in a direction that no piece determines, that of the prior."""
    turn_rad: float
    turn_sigma_rad: float
    arm_mm: float
    """Distance from the centre of the pieces to the furthest piece."""
    pieces: int

    @property
    def excess_mm(self) -> float:
        """Length of the parts of the shift, along the axes of its covariance, beyond cutting errors and noise."""
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
    """Measure the shift of the outline against the position by C; None where too little of it shows an edge."""
    if len(straight_pieces(outline_polygons(board_type), board_type.mm_per_unit)) < _LEAST_PIECES:
        return None
    board = apply(cad_matrix, outline_pieces(board_type))
    _, normal, steps = edge_profiles(board, scene, motion)
    shown = (steps >= _LEAST_STEP).any(1)
    if shown.sum() < _LEAST_PIECES:
        return None
    board, normal, steps = board[shown], normal[shown], steps[shown]
    return _fitted(board.mean(1), normal, steps, _voted(steps, normal))


def edge_profiles(board: Floats, scene: Scene, motion: Motion) -> tuple[float, Floats, Floats]:
    """Measure the steps of grey level across k pieces (k, 2, 2), start and end in mm, of a closed polygon.

    Returns the distance of samples in mm, the outward normals (k, 2), and the step's height at each sample (k, samples)
    from inside to outside; 0 where no frame shows it.
    """
    # The sign of the area gives the direction in which the polygon runs, and so the side on which the board lies.
    a, b = np.moveaxis(board - board.mean((0, 1)), 1, 0)
    area = (a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]).sum()
    normal = -_left_normals(board) * np.sign(area)
    frames = scene.index(motion.rows_from_tester)
    number, reach, samples = frames.nearest(board.mean(1)), _REACH * _STEP_MM * normal, 2 * _REACH + 1
    # Within a piece the picture is taken as straight: three of its corners give the pixels of all samples.
    px = frames.project(number, np.stack([board[:, 0] - reach, board[:, 1] - reach, board[:, 0] + reach], 1))
    along, across = (px[:, 1] - px[:, 0]) / _ALONG, (px[:, 2] - px[:, 0]) / (samples - 1)
    start = px[:, 0] + along / 2
    profiles = frames.read_samples(
        number, samples, lambda image, mine: _sampled(image, start[mine], along[mine], across[mine], samples)
    )
    return _STEP_MM, normal, _steps(profiles)


@compiled
def _sampled(image: NDArray[np.uint8], start: Floats, along: Floats, across: Floats, samples: int) -> Floats:
    """Sample a profile of grey levels for each of k pieces: (k, samples); NaN outside the image.

    Sample s of piece k is the mean over `_ALONG` points from `start[k] + s · across[k]` on, `along[k]` apart, raw px.
    """
    out = np.empty((len(start), samples))
    height, width = image.shape
    for k in range(len(start)):
        ax, ay = along[k, 0], along[k, 1]
        for s in range(samples):
            x, y = start[k, 0] + s * across[k, 0], start[k, 1] + s * across[k, 1]
            last_x, last_y = x + (_ALONG - 1) * ax, y + (_ALONG - 1) * ay
            if min(x, y, last_x, last_y) < 0 or max(x, last_x) >= width - 1 or max(y, last_y) >= height - 1:
                out[k, s] = np.nan
                continue
            total = 0.0
            for n in range(_ALONG):
                px, py = x + n * ax, y + n * ay
                j, i = int(px), int(py)
                u, v = px - j, py - i
                above = image[i, j] * (1 - u) + image[i, j + 1] * u
                below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
                total += above * (1 - v) + below * v
            out[k, s] = total / _ALONG
    return out


def _steps(profiles: Floats) -> Floats:
    """Compute the height of the grey-level step at each sample of k profiles, (k, samples); 0 where it is unknown."""
    at = np.arange(_GAP + _SIDE, profiles.shape[1] - _GAP - _SIDE)
    # Prefix sums give the means on both sides of every sample in one pass.
    sums, blind = (
        np.concatenate([np.zeros((len(profiles), 1)), np.cumsum(values, 1)], 1)
        for values in (np.nan_to_num(profiles), np.isnan(profiles))
    )
    far, near = at + _GAP + 1 + _SIDE, at - _GAP - _SIDE
    step = np.abs(sums[:, far] - sums[:, far - _SIDE] - sums[:, near + _SIDE] + sums[:, near]) / _SIDE
    out = np.zeros(profiles.shape)
    out[:, at] = np.where(blind[:, far] > blind[:, near], 0.0, step)
    return out


def _voted(steps: Floats, normal: Floats) -> Floats:
    tries = np.arange(-_VOTES, _VOTES + 1) * _VOTE_MM
    weight, grid = np.minimum(steps, _MOST_STEP), np.asarray(tries, np.float64)
    votes = _vote_histogram(weight, normal, grid)
    i, j = np.unravel_index(int(votes.argmax()), votes.shape)
    shift, near = np.array([tries[j], tries[i]]), np.abs(tries) <= _LIMIT_MM + _VOTE_MM / 2
    if near[i] and near[j]:
        return shift
    # Only pieces that the shift moves across themselves distinguish it from none.
    across = normal @ shift
    for some, least in (
        (np.abs(across) > _MOVED_MM, _CLEARLY),
        (across > _MOVED_MM, _OPPOSED),
        (across < -_MOVED_MM, _OPPOSED),
    ):
        support = _vote_histogram(weight[some], normal[some], grid)
        if support[i, j] < least * support[np.ix_(near, near)].max():
            row, column = np.unravel_index(int(votes[np.ix_(near, near)].argmax()), (near.sum(), near.sum()))
            return np.array([tries[near][column], tries[near][row]])
    return shift


def _vote_histogram(steps: Floats, normal: Floats, tries: Floats) -> Floats:
    """Sum the steps (k, samples) of all pieces for every shift: (t, t), shifts along y by shifts along x."""
    # Samples are added at the ends of the lines, so that no shift reads beyond them.
    out, far = np.zeros((len(tries), len(tries))), int(2 * np.abs(tries).max() / _STEP_MM) + 1
    # Pieces of one direction, of which a board has few, are summed first.
    ways, side = np.unique(np.round(normal, 9) @ (1, 1j), return_inverse=True)
    for number, way in enumerate(ways.tolist()):
        line = np.pad(steps[side == number].sum(0), far)
        at = (way.imag * tries[:, None] + way.real * tries) / _STEP_MM
        out += line[(at + (far + steps.shape[1] // 2 + 0.5)).astype(np.int_)]
    return out


def _fitted(middle: Floats, normal: Floats, steps: Floats, shift: Floats) -> OutlineShift | None:
    """Estimate shift, turn and excess size of the outline by robust least squares over the edges near `shift` (2,)."""
    offset, height = _edges(steps, normal @ shift / _STEP_MM + _REACH)
    use = height >= _LEAST_STEP
    if use.sum() < _LEAST_PIECES:
        return None
    offset, n, arm = (offset[use] - _REACH) * _STEP_MM, normal[use], middle[use] - middle.mean(0)
    j = np.column_stack([n, arm[:, 0] * n[:, 1] - arm[:, 1] * n[:, 0], np.ones(len(n))])
    weight, scatter, prior = np.ones(len(n)), _PIECE_SIGMA_MM, np.diag(_PRIOR**-2.0)
    for _ in range(_ROUNDS):
        weighted = j.T * (weight / scatter**2)
        normal = weighted @ j + prior
        solved = np.linalg.solve(normal, weighted @ offset)
        residual = offset - j @ solved
        # 1.4826: from the median absolute deviation to the standard deviation of a normal distribution.
        scatter = max(1.4826 * float(np.median(np.abs(residual))), _PIECE_SIGMA_MM)
        weight = huber_weights(residual / scatter, _KNEE)
    inverse = np.linalg.inv(normal)
    # A cutting error moves all pieces together, so the residuals of the fit do not show it.
    covariance, turn_sigma = inverse[:2, :2] + _MACHINED_MM**2 * np.eye(2), float(np.sqrt(inverse[2, 2]))
    return OutlineShift(
        np.asarray(solved[:2], np.float64),
        covariance,
        float(solved[2]),
        turn_sigma,
        float(np.hypot(*arm.T).max()),
        len(n),
    )


def _edges(steps: Floats, expected: Floats) -> tuple[Floats, Floats]:
    """Locate the edge of each piece near `expected` (k,), in samples; return positions (k,) and step heights (k,)."""
    near = np.clip(np.rint(expected).astype(int)[:, None] + np.arange(-_NEAR, _NEAR + 1), 1, steps.shape[1] - 2)
    rows = np.arange(len(steps))
    at = near[rows, np.take_along_axis(steps, near, 1).argmax(1)]
    before, top, after = steps[rows, at - 1], steps[rows, at], steps[rows, at + 1]
    bend = before - 2 * top + after
    off = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    return at + np.clip(off, -0.5, 0.5), top


class LeftOut(NamedTuple):
    """The links that were left out because they lie beside the board."""

    share: float
    """Share of these links in all links between rows."""
    confirmed: bool
    links: Observations


def beside(plane: BoardPlane, c: Floats, board_mm: Floats, margin_mm: float = _MARGIN_MM) -> NDArray[np.bool_]:
    """Return which board points (k, 2), mm, lie outside the outline by more than a margin; none without an outline.

    With a negative margin, points inside the outline and nearer to it than the margin count as outside too.
    """
    return depths_mm(plane.board_type, apply(np.linalg.inv(plane.matrix(c)), board_mm)) < -margin_mm


def depths_mm(board_type: BoardType, cad: Floats) -> Floats:
    """Return how far (k,) points in CAD coordinates (k, 2) lie inside the outline, negative outside; ∞ without one."""
    polygons = outline_polygons(board_type)
    # A board type with fixture marks describes its carrier: links there are meant to be used.
    if not polygons or board_type.fixture_marks:
        return np.full(len(cad), np.inf)
    ends = polygons[0]
    x, y = np.ascontiguousarray(cad.T)
    low, high = ends.min(0), ends.max(0)
    if len(ends) == 4 and all(len(set(of_axis)) == 2 for of_axis in ends.T.tolist()):
        # Most boards are rectangles along the axes: beyond two sides, the nearest place is a corner.
        beyond_x = np.maximum(low[0] - x, x - high[0])
        beyond_y = np.maximum(low[1] - y, y - high[1])
        depth, corner = -np.maximum(beyond_x, beyond_y), np.flatnonzero((beyond_x > 0) & (beyond_y > 0))
        depth[corner] = -np.hypot(beyond_x[corner], beyond_y[corner])
        return np.asarray(depth * board_type.mm_per_unit)
    inside, near = np.zeros(len(cad), np.bool_), np.full(len(cad), np.inf)
    for (ax, ay), (bx, by) in zip(ends.tolist(), np.roll(ends, -1, 0).tolist(), strict=True):
        u, v, wx, wy = x - ax, y - ay, bx - ax, by - ay
        # A ray to the right crosses the outline of a simple polygon an odd number of times from inside.
        inside ^= ((ay > y) != (by > y)) & (u < v * (wx / wy if wy else 0.0))
        along = np.clip((u * wx + v * wy) / max(wx * wx + wy * wy, 1e-12), 0, 1)
        u -= along * wx
        v -= along * wy
        near = np.minimum(near, u * u + v * v)
    return np.asarray(np.where(inside, 1, -1) * np.sqrt(near) * board_type.mm_per_unit)


def link_depths_mm(plane: BoardPlane, c: Floats, links: Observations, motion: Motion) -> Floats:
    """Return how far (k,) the first points of links lie inside the outline of a board at position `c`: `depths_mm`."""
    return depths_mm(plane.board_type, apply(np.linalg.inv(plane.matrix(c)), motion.board(links.p, links.a_mm)))


def shares_beside(depth_mm: Floats, links: Observations) -> tuple[float, float]:
    """Return the share of the links between rows that lie beside the board, and that of the links between cameras."""
    off, between = depth_mm < -_MARGIN_MM, links.p == links.q
    return float(off[~between].sum() / max((~between).sum(), 1)), float(off[between].sum() / max(between.sum(), 1))


def links_on_board(
    plane: BoardPlane, c: Floats, links: Observations, motion: Motion, px_per_mm: float
) -> NDArray[np.int_]:
    """Return the indices of the links whose patches lie wholly on the board."""
    return np.flatnonzero(link_depths_mm(plane, c, links, motion) >= HALF_PATCH_PX / px_per_mm)


def without_links_beside(problem: Problem, depth_mm: Floats, confirmed: Callable[[], bool]) -> Problem:
    """Return a problem without those links beside the board (`link_depths_mm`) that may be left out in any case.

    Links between cameras there, at another height than the board, would bend its surface or show a displaced camera
    (seed 100346). Between rows, links outside the outline are left out if they are more than `_MOST_AT_EDGE` of a pair
    of frames, and if the pictures confirm the outline (`confirmed`): along the edge of the board, patches are found
    where the texture of a bed is (seed 102577).
    """
    links, off = problem.links, np.flatnonzero(depth_mm < 0)
    if not len(off):
        return problem
    of_pairs = np.diff(links.begins)
    share = np.bincount(links.group[off], minlength=len(of_pairs)) / np.maximum(of_pairs, 1)
    left_out = links.p[off] == links.q[off]
    at_edge = ~left_out & (share[links.group[off]] > _MOST_AT_EDGE)
    # The outline is checked only where it matters: that takes longer than all else here.
    if at_edge.any() and confirmed():
        left_out |= at_edge
    return problem.select(np.delete(np.arange(len(links)), off[left_out])) if left_out.any() else problem


def outline_confirmed(plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion) -> bool:
    """Return whether every side of the outline that is in view shows its edge where C (`cad_matrix`) puts it."""
    pieces = outline_pieces(plane.board_type)
    if not len(pieces):
        return False
    board = apply(cad_matrix, pieces)
    step_mm, normal, steps = edge_profiles(board, scene, motion)
    offset = (np.arange(steps.shape[1]) - steps.shape[1] // 2) * step_mm
    at_edge, seen = np.abs(offset) <= _EDGE_NEAR_MM, (steps > 0).mean(1) > 0.5
    others = other_steps(plane, cad_matrix, board, normal[:, None] * offset[:, None], steps, 2 * _EDGE_NEAR_MM)
    side = np.rint(np.arctan2(normal[:, 1], normal[:, 0]) / (np.pi / 4)).astype(int) % 8
    every = [np.flatnonzero(seen & (side == one)) for one in np.unique(side[seen])]
    sides = [mine for mine in every if len(mine) >= _PIECES_OF_SIDE]
    limits = [max(_LEAST_EDGE, _STANDS_OUT * strongest_line(others[mine])) for mine in sides]
    return bool(sides) and all(
        strongest_line(steps[mine][:, at_edge]) >= least for mine, least in zip(sides, limits, strict=True)
    )


def other_steps(
    plane: BoardPlane, cad_matrix: Floats, board_mm: Floats, offset_mm: Floats, steps: Floats, beyond_mm: float
) -> Floats:
    """Return the steps (k, samples) across pieces (k, 2, 2), NaN up to `beyond_mm` from them and at components' edges.

    `offset_mm` (k, samples, 2) are the displacements, in tester coordinates, at which the steps were measured.
    """
    along = np.stack([board_mm[:, 0], board_mm.mean(1), board_mm[:, 1]], 1)
    points = along[:, :, None] + offset_mm[:, None]
    cad_from_board = np.asarray(np.linalg.inv(cad_matrix), np.float64)
    found = plane.components.widened(_PART_MM).find(cad_from_board, points.reshape(-1, 2))
    shows_part = (found >= 0).reshape(points.shape[:3]).any(1)
    away = np.hypot(offset_mm[..., 0], offset_mm[..., 1]) > beyond_mm
    return np.where(away & ~shows_part, steps, np.nan)


def strongest_line(steps: Floats) -> float:
    """Return the strongest step of a line along pieces of a side, from their steps (k, samples); NaN is unknown."""
    values = steps[:, np.isfinite(steps).mean(0) >= _QUANTILE]
    if not values.size:
        return 0.0
    # `numpy.nanquantile` gives the same, but takes more than a hundred times as long. NaN is sorted behind all numbers.
    at = _QUANTILE * (np.isfinite(values).sum(0) - 1)
    ascending, low, column = np.sort(values, axis=0), np.floor(at).astype(np.int_), np.arange(values.shape[1])
    below, above = ascending[low, column], ascending[np.ceil(at).astype(np.int_), column]
    return float((below + (at - low) * (above - below)).max(initial=0.0))
