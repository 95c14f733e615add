"""Estimate the motion of the rows before the board is located by its CAD data (paper, sections 3.3.1 and 3.3.2).

Estimate a first row motion, accurate to a pixel, from the median shift of the links between rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Observations, Problem, to_observations
from vaoi_station.stitching.adjustment.solver import adjust, evaluate_at, solve_subsampled
from vaoi_station.stitching.matching.evidence import Detections, Links, Task

_LEAST_LINKS = 3  # least number of links that connect two rows


def chain_links(nominal: Motion, links: Observations) -> Motion:
    """Estimate the shift of every row from the median of its links to the latest earlier row.

    A row without such links moves from the row before as in the nominal motion. A median is taken over the links of all
    cameras, so that a single frame with tall parts or reflections has little influence.
    """
    shift = nominal.shift.copy()
    rows = len(shift)
    by_pair = np.argsort(links.q * rows + links.p, kind="stable")
    p, q = links.p[by_pair], links.q[by_pair]
    for row in range(1, rows):
        first, last = np.searchsorted(q, (row, row + 1))
        # links between two cameras have p = q = row and are left out
        last = first + np.searchsorted(p[first:last], row)
        if last > first:
            # Only links to the latest earlier row are used: errors grow with the distance between the rows.
            latest = by_pair[first + np.searchsorted(p[first:last], p[last - 1]) : last]
            step = links.a_mm[latest] - links.b_mm[latest]
            shift[row] = shift[p[last - 1]] + np.median(step, axis=0)
        else:
            shift[row] = shift[row - 1] + nominal.shift[row] - nominal.shift[row - 1]
    return replace(nominal, shift=shift)


def connected_rows(links: Observations, rows: int, used: np.ndarray) -> list[np.ndarray]:
    """Return the groups of rows that are connected by links, as arrays of row indices. A complete run has one group.

    `rows` is the number of rows; `used` selects the links that count. Of a pair of rows, at least `_LEAST_LINKS` count:
    fewer always fit some motion, so that false ones would connect the rows.
    """
    label = np.arange(rows)
    count = np.bincount(links.p[used] * rows + links.q[used])
    for pair in np.flatnonzero(count >= _LEAST_LINKS):
        a, b = label[pair // rows], label[pair % rows]
        label[label == max(a, b)] = min(a, b)
    return [np.flatnonzero(label == k) for k in np.unique(label)]


_CONVERGED_MM = 5e-4
"""The estimation of the motion from links alone ends when no row moves by more than this in a step.

This is accurate enough to locate the board. The adjustment with the CAD mapping then estimates the motion again."""
_TEXTURE_SAMPLE, _ON_BOARD_WEIGHT = 4000, 0.5
"""About how many points represent the texture of the board, and the least robust weight of their links."""
_NEAR_MM = 1.2  # largest distance of a mark from the position that the nominal motion predicts


def motion_from_links(problem: Problem, nominal: Motion) -> AdjustmentResult:
    """Estimate the motion of the rows from texture that is linked between rows and between cameras."""
    start = chain_links(nominal, problem.links)
    # If there are many links, a subsample gives the motion to 1 µm; then all links are evaluated at this motion.
    subsampled = solve_subsampled(problem, start)
    if subsampled is None:
        return adjust(problem, start, converged_mm=_CONVERGED_MM)
    return evaluate_at(problem, subsampled)


def motion_from_marks(
    problem: Problem, nominal: Motion, detections: Sequence[Detections], cameras: Sequence[Camera]
) -> AdjustmentResult:
    """Estimate the motion of the rows from detected marks alone. The links of the problem are not used."""
    links = to_observations(mark_links(detections, cameras, nominal), cameras)
    by_marks = replace(problem, links=links, component=np.full(len(links), -1))
    return adjust(by_marks, chain_links(nominal, links))


def mark_links(detections: Sequence[Detections], cameras: Sequence[Camera], nominal: Motion) -> list[Links]:
    """Link the marks of each camera in every row to those in the next row in which the camera detected marks.

    The nominal motion of the belt predicts where a mark appears in the next row. Its error is smaller than the distance
    between two marks, so that the prediction identifies the mark. Marks with more than one possible partner are left
    out (section 3.3.1 of the paper).
    """
    links = []
    for i, camera in enumerate(cameras):
        seen = sorted((s for s in detections if s.task.a[0] == i and len(s.px)), key=lambda s: s.task.a[1])
        for a, b in pairwise(seen):
            links.append(_link_marks(a, b, camera, nominal))
    return links


def _link_marks(a: Detections, b: Detections, camera: Camera, nominal: Motion) -> Links:
    """Link those marks of two frames of a camera that have exactly one possible partner each.

    Partners have the same kind and lie within `_NEAR_MM` of each other at nominal motion.
    """
    task = Task("rows", a.task.a, b.task.a)
    places = [nominal.board(np.full(len(s.px), s.task.a[1]), camera.ground(s.px)) for s in (a, b)]
    distance = np.hypot(*np.moveaxis(places[1][None] - places[0][:, None], 2, 0))
    distance[a.kind[:, None] != b.kind[None]] = np.inf
    k = np.flatnonzero((distance < _NEAR_MM).sum(1) == 1)
    n = distance[k].argmin(1)
    # The partner must not have a second mark near it either.
    alone = (distance[:, n] < _NEAR_MM).sum(0) == 1
    k, n = k[alone], n[alone]
    if not len(k):
        return Links.empty(task, "no mark is in both rows")
    variance = a.sigma_px[k] ** 2 + b.sigma_px[n] ** 2
    information = np.eye(2) / variance[:, None, None]
    return Links(task, a.px[k], b.px[n], information, np.minimum(a.score[k], b.score[n]))


def board_texture(links: Observations, moved: AdjustmentResult) -> Floats:
    """Return points (k, 2) of the board's texture, in tester coordinates: the points of links that fit the motion.

    Only links between rows are used. If there are many, the points are a sample.
    """
    use = np.flatnonzero((moved.weight > _ON_BOARD_WEIGHT) & (links.p != links.q))
    use = use[:: max(len(use) // _TEXTURE_SAMPLE, 1)]
    return moved.motion.board(links.p[use], links.a_mm[use])
