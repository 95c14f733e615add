"""Estimate the motion of the rows before the board is located by its CAD data (paper, sections 3.3.1 and 3.3.2)."""

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
"""The estimation of the motion from links alone ends when no row moves by more than this in a step.

This is accurate enough to locate the board. The adjustment with the CAD mapping then estimates the motion again."""
_TEXTURE_SAMPLE, _ON_BOARD_WEIGHT = 4000, 0.5
"""About how many points represent the texture of the board, and the least robust weight of their links."""


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


def board_texture(links: Observations, moved: AdjustmentResult) -> Floats:
    """Return points (k, 2) of the board's texture, in tester coordinates: the points of links that fit the motion.

    Only links between rows are used. If there are many, the points are a sample.
    """
    use = np.flatnonzero((moved.weight > _ON_BOARD_WEIGHT) & (links.p != links.q))
    use = use[:: max(len(use) // _TEXTURE_SAMPLE, 1)]
    return moved.motion.board(links.p[use], links.a_mm[use])
