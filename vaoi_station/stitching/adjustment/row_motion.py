"""Estimate the motion of the rows before the board is found (sections 3.3.1 and 3.3.2 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.initial_motion import chain_links
from vaoi_station.stitching.adjustment.mark_links import mark_links
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Observations, to_observations
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.adjustment.solver import adjust, evaluate_at, solve_subsampled
from vaoi_station.stitching.matching.evidence import Detections

_CONVERGED_MM = 5e-4
"""Convergence of the motion from links: enough to find the board, after which everything is adjusted once more."""
_TEXTURE_SAMPLE, _ON_BOARD_WEIGHT = 4000, 0.5
"""Number of points that represent the board's texture, and their least robust weight."""


def motion_from_links(problem: Problem, nominal: Motion) -> AdjustmentResult:
    """Estimate the motion from texture linked between rows and cameras."""
    start = chain_links(nominal, problem.links)
    # of many links a subsample gives the motion to a micrometre; all of them are then weighed at it without a step
    subsampled = solve_subsampled(problem, start)
    if subsampled is None:
        return adjust(problem, start, converged_mm=_CONVERGED_MM)
    return evaluate_at(problem, subsampled)


def motion_from_marks(
    problem: Problem, nominal: Motion, detections: Sequence[Detections], cameras: Sequence[Camera]
) -> AdjustmentResult:
    """Estimate the motion from marks alone; the links of the problem are not used."""
    links = to_observations(mark_links(detections, cameras, nominal), cameras)
    by_marks = replace(problem, links=links, component=np.full(len(links), -1))
    return adjust(by_marks, chain_links(nominal, links))


def board_texture(links: Observations, moved: AdjustmentResult) -> Floats:
    """Return points (k, 2) that were linked from row to row and move with the board; a sample if there are many."""
    use = np.flatnonzero((moved.weight > _ON_BOARD_WEIGHT) & (links.p != links.q))
    use = use[:: max(len(use) // _TEXTURE_SAMPLE, 1)]
    return moved.motion.board(links.p[use], links.a_mm[use])
