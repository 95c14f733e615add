"""Estimate the motion of the rows before the board is located by its CAD data (paper, sections 3.3.1 and 3.3.2).

What the links of two rows show of the motion between them is one turn and one shift (`RowStep`), which is computed when
these links are complete. From those of all pairs of rows the motion follows at once. It is accurate to about a tenth of
a pixel, which is enough to locate the board; the adjustment with the CAD mapping then estimates it from all links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import attrgetter

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import (
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    solve_backward,
    solve_forward,
)
from vaoi_station.stitching.adjustment.motion import Motion, RowStep, belt_equations, measure_step
from vaoi_station.stitching.adjustment.problem import (
    AdjustmentResult,
    Observations,
    Problem,
    to_observations,
)
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.matching.evidence import Detections, Links, Task

_LEAST_LINKS = 3  # least number of links that connect two rows
_ROUNDS, _KNEE = 2, 2.0
"""How often the motion is estimated from all steps, and from how many standard deviations on a step loses weight."""
_COMMON_PX, _COMMON_SHARE, _LIGHTS_PX = 0.02, 0.25, 0.3
"""Error that the links of a step have in common: generally, as a share of their scatter, and between two lights.

Bodies lean by different amounts over different distances of rows, and the bright edges of metal move with the lamp."""


@dataclass(frozen=True, eq=False)
class MovedRows:
    """The motion of the rows by links or marks, before the board is located."""

    motion: Motion
    problem: Problem

    @cached_property
    def result(self) -> AdjustmentResult:
        """The motion as an adjustment of all links estimates it: the result of a run whose board is not located."""
        return adjust(self.problem, self.motion)


def chain_steps(steps: Sequence[RowStep], nominal: Motion) -> Motion:
    """Place every row by its step from the latest earlier row, since errors grow with the distance of the rows.

    A row without a step moves from the row before as in the nominal motion.
    """
    latest: dict[int, RowStep] = {}
    for one in steps:
        if one.q not in latest or (one.p, one.weight) > (latest[one.q].p, latest[one.q].weight):
            latest[one.q] = one
    about, belt = complex(*nominal.pivot), [complex(*v) for v in nominal.shift.tolist()]
    angle, shift = [0.0], [belt[0]]
    for row in range(1, len(belt)):
        if row in latest:
            one = latest[row]
            angle.append(angle[one.p] + one.turn)
            first = np.exp(1j * angle[one.p]) * (one.a_mm - about) + shift[one.p]
            shift.append(complex(first - np.exp(1j * angle[row]) * (one.b_mm - about)))
        else:
            angle.append(angle[-1])
            shift.append(shift[-1] + belt[row] - belt[row - 1])
    return Motion(np.array(angle), np.array([(s.real, s.imag) for s in shift]), nominal.pivot)


def join_steps(problem: Problem, steps: Sequence[RowStep], nominal: Motion) -> Motion:
    """Return the motion that fits all steps between rows best, with the prior of the belt's motion."""
    motion, rows = chain_steps(steps, nominal), len(nominal.angle)
    if rows < 2:
        return motion
    p, q = (np.array([getattr(one, end) for one in steps], dtype=np.int_) for end in "pq")
    about = complex(*nominal.pivot)
    a, b = (np.array([getattr(one, end) - about for one in steps], np.complex128) for end in ("a_mm", "b_mm"))
    turn, weight, turn_weight, floor_mm, px_per_mm = (
        np.array([getattr(one, name) for one in steps])
        for name in ("turn", "weight", "turn_weight", "floor_mm", "px_per_mm")
    )
    common_mm = np.maximum(_COMMON_PX / px_per_mm, _COMMON_SHARE * floor_mm)
    if len(problem.light):
        common_mm = np.where(problem.light[p] != problem.light[q], _LIGHTS_PX / px_per_mm, common_mm)
    # The weights of n links with an error in common sum to at most its inverse variance.
    share = 1 / (1 + weight * common_mm**2)
    scale = np.sqrt(np.stack([turn_weight, weight, weight], 1) * share[:, None])
    columns = np.concatenate([3 * p[:, None] + np.arange(3), 3 * q[:, None] + np.arange(3)], 1)
    jacobian = np.zeros((len(steps), 3, 6))
    jacobian[:, :, :3], jacobian[:, :, 3:] = -np.eye(3), np.eye(3)
    crossed = np.bincount(p, minlength=rows) - np.bincount(q, minlength=rows)
    linked = np.cumsum(crossed)[:-1] > 0
    furthest = np.minimum(np.arange(rows) + 1, rows - 1)
    np.maximum.at(furthest, p, q)
    empty, robust = NormalEquations.of(furthest, 0), np.ones(len(steps))
    for _ in range(_ROUNDS):
        of_p, of_q = np.exp(1j * motion.angle[p]) * a, np.exp(1j * motion.angle[q]) * b
        apart = of_q - of_p
        residual = np.empty((len(steps), 3))
        residual[:, 0] = motion.angle[q] - motion.angle[p] - turn
        residual[:, 1:] = motion.shift[q] - motion.shift[p] + np.stack([apart.real, apart.imag], 1)
        jacobian[:, 1, 0], jacobian[:, 2, 0] = of_p.imag, -of_p.real
        jacobian[:, 1, 3], jacobian[:, 2, 3] = -of_q.imag, of_q.real
        residual *= scale
        robust = huber_weights(np.sqrt((residual[:, 1:] ** 2).sum(1) / 2), _KNEE)
        whitening = np.sqrt(robust)[:, None]
        normal = empty.zeros()
        add_equations(columns, jacobian * (scale * whitening)[:, :, None], residual * whitening, normal)
        add_equations(*belt_equations(motion, problem.times_s, problem.velocity_mm_s, linked), normal)
        hold_first_row(normal)
        factorise(normal)
        delta = solve_backward(normal, solve_forward(normal)).reshape(rows, 3)
        motion = replace(motion, angle=motion.angle + delta[:, 0], shift=motion.shift + delta[:, 1:])
    return motion


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


_FEW_PER_ROW, _CONVERGED_MM = 60, 5e-4
"""With fewer links per row, all of them are adjusted before the board is located, until no row moves by more than this.

Where they are few and blurred, how much they scatter depends on the motion with which the estimation starts (seed
120063)."""
_TEXTURE_SAMPLE, _FIT, _FIT_MM = 4000, 5.0, 0.02
"""About how many points represent the texture of the board, and by how much their links may contradict the motion.

It is the first limit, in medians of what links contradict it by: about four standard deviations. The median counts as
at least the second limit."""
_NEAR_MM = 1.2  # largest distance of a mark from the position that the nominal motion predicts


def motion_from_links(problem: Problem, nominal: Motion, steps: Sequence[RowStep] | None = None) -> MovedRows:
    """Estimate the motion of the rows from texture that is linked between rows.

    `steps` are those that all links between rows show; without them, they are measured.
    """
    motion = join_steps(problem, measured_steps(problem.links) if steps is None else steps, nominal)
    if 0 < len(problem.links) < _FEW_PER_ROW * len(nominal.angle):
        motion = adjust(problem, motion, converged_mm=_CONVERGED_MM).motion
    return MovedRows(motion, problem)


def measured_steps(links: Observations) -> list[RowStep]:
    """Measure the steps between rows that links show, of which those of two rows are adjacent."""
    begins = np.flatnonzero((np.diff(links.p, prepend=-1) != 0) | (np.diff(links.q, prepend=-1) != 0)).tolist()
    out = []
    for begin, end in pairwise([*begins, len(links)]):
        p, q = int(links.p[begin]), int(links.q[begin])
        if p != q:
            own = slice(begin, end)
            of_links = links.a_mm[own], links.b_mm[own], links.noise_mm2[own], links.px_per_mm[own], links.overlap[own]
            out.append(measure_step(p, q, *of_links))
    return out


def motion_from_marks(
    problem: Problem, nominal: Motion, detections: Sequence[Detections], cameras: Sequence[Camera]
) -> MovedRows:
    """Estimate the motion of the rows from detected marks alone. The links of the problem are not used."""
    links = to_observations(sorted(mark_links(detections, cameras, nominal), key=attrgetter("rows")), cameras)
    by_marks = replace(problem, links=links, component=np.full(len(links), -1))
    return MovedRows(adjust(by_marks, motion_from_links(by_marks, nominal).motion).motion, by_marks)


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


def board_texture(links: Observations, moved: MovedRows | AdjustmentResult) -> Floats:
    """Return points (k, 2) of the board's texture, in tester coordinates: the points of links that fit the motion.

    Only links between rows are used. If there are many, the points are a sample.
    """
    use = np.flatnonzero(links.p != links.q)
    use = use[:: max(len(use) // _TEXTURE_SAMPLE, 1)]
    at_mm = moved.motion.board(links.p[use], links.a_mm[use])
    apart_mm = np.hypot(*(moved.motion.board(links.q[use], links.b_mm[use]) - at_mm).T)
    if not len(use):
        return at_mm
    return np.asarray(at_mm[apart_mm <= _FIT * max(float(np.median(apart_mm)), _FIT_MM)])
