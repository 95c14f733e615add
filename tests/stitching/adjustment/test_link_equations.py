"""The compiled passes over the links agree with numpy, one link at a time, and with derivatives by differences."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stitching.adjustment.test_envelope import dense
from vaoi_station.stitching.adjustment.cameras import CameraEffects
from vaoi_station.stitching.adjustment.envelope import NormalEquations, add_equations
from vaoi_station.stitching.adjustment.equations import (
    Coupling,
    LinkModel,
    LinkState,
    NoiseModel,
    PointHeights,
    add_links,
    compute_residuals,
    compute_weights,
    eliminate_heights,
)
from vaoi_station.stitching.adjustment.motion import MotionArrays
from vaoi_station.stitching.adjustment.problem import LinkArrays

Array = NDArray[np.float64]
ROWS, LINKS, BASIS, PARTS, CAMERAS = 4, 60, 3, 5, 3
AT_CAMERAS = 3 * ROWS + BASIS
SIZE = AT_CAMERAS + 3 * CAMERAS
TOTAL = SIZE + PARTS
NONE_RAISED = np.zeros(LINKS, np.bool_)
FLAT = np.zeros(LINKS)
BARE = np.full(LINKS, -1)


@dataclass
class Scene:
    links: LinkArrays
    basis: Array
    component: NDArray[np.int_]
    pivot: Array
    effects: CameraEffects

    def motion(self, unknowns: Array) -> MotionArrays:
        rows = unknowns[: 3 * ROWS].reshape(ROWS, 3)
        return MotionArrays(np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1:]), self.pivot)

    def residual(self, unknowns: Array) -> Array:
        """(k, 2) from rows (φ, sx, sy), surface, displacements and heights in one vector, by the definition."""
        o, rows = self.links, unknowns[: 3 * ROWS].reshape(ROWS, 3)
        beta, heights = unknowns[3 * ROWS : AT_CAMERAS], np.append(unknowns[SIZE:], 0.0)
        displacements = unknowns[AT_CAMERAS:SIZE].reshape(CAMERAS, 3)
        out = []
        for n in range(LINKS):
            h = self.basis[n] @ beta + heights[self.component[n]]
            board, lean = [], []
            of_a, of_b = o.camera_a[n], o.camera_b[n]
            ends = (o.q[n], o.b_mm[n], o.b_lean[n], of_b), (o.p[n], o.a_mm[n], o.a_lean[n], of_a)
            for row, seen, of, camera in ends:
                theta, tx, ty = self.effects.motion[camera] @ displacements[camera]
                x, y = seen - self.effects.middle_mm[camera]
                at = seen + (tx - theta * y, ty + theta * x)
                c, s = np.cos(rows[row, 0]), np.sin(rows[row, 0])
                turn = np.array([[c, -s], [s, c]])
                board.append(turn @ (at - self.pivot) + self.pivot + rows[row, 1:])
                lean.append(turn @ of)
            out.append(board[0] - board[1] + (lean[0] - lean[1]) * h)
        return np.array(out)

    def evaluate(self, unknowns: Array) -> LinkState:
        """The compiled residuals at these unknowns."""
        heights = np.append(unknowns[SIZE:], 0.0)
        height = PointHeights(self.basis, unknowns[3 * ROWS : AT_CAMERAS], self.component, heights)
        state = LinkState.of(self.links, movable=False)
        compute_residuals(self.links, self.motion(unknowns), np.zeros((0, 3, 3)), height, state)
        return state

    def jacobian(self, unknowns: Array, step: float = 1e-6) -> Array:
        """(k, 2, u) by central differences."""
        eye = np.eye(TOTAL) * step
        return np.stack([(self.residual(unknowns + d) - self.residual(unknowns - d)) / (2 * step) for d in eye], -1)


@pytest.fixture
def scene() -> Scene:
    g = np.random.default_rng(3)
    p = np.sort(g.integers(0, ROWS - 1, LINKS))
    q = np.where(np.arange(LINKS) % 2, p, p + 1)
    order = np.lexsort((q, p))
    p, q = p[order], q[order]
    group = np.concatenate([[0], np.cumsum(np.diff(p * ROWS + q) != 0)])
    places, leans = g.normal(0, 10, (2, LINKS, 2)), g.normal(0, 0.02, (2, LINKS, 2))
    noise, resolution, overlap = np.tile(np.diag([1e-4, 4e-4]), (LINKS, 1, 1)), np.full(LINKS, 20.0), np.ones(LINKS)
    a = g.integers(0, CAMERAS - 1, group[-1] + 1)[group]
    links = LinkArrays._make([p, q, a, a + (p == q), group, *places, *leans, noise, resolution, overlap])
    model = g.normal(0, 1, (LINKS, BASIS)), g.integers(-1, PARTS, LINKS)
    effects = CameraEffects(g.normal(0, 0.1, (CAMERAS, 3, 3)), g.normal(0, 10, (CAMERAS, 2)))
    return Scene(links, *model, np.array([3.0, -2.0]), effects)


def test_normal_equations_are_those_of_the_linearised_residuals(scene: Scene) -> None:
    unknowns = np.zeros(TOTAL)
    # at height 0 the lean does not turn with the row: the equations leave that small derivative out
    unknowns[: 3 * ROWS] = np.random.default_rng(5).normal(0, 0.05, 3 * ROWS)
    root = np.random.default_rng(6).normal(0, 1, (LINKS, 2, 2))
    matrices = root @ root.swapaxes(1, 2)
    state = scene.evaluate(unknowns)
    state.weight[:] = np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], -1)
    tied = Coupling.of(scene.component, PARTS, scene.links, ROWS, BASIS, (3 * ROWS, AT_CAMERAS))
    normal = NormalEquations.of(np.full(ROWS, ROWS - 1), BASIS + 3 * CAMERAS)
    heights, motion = tied.equations(np.zeros(PARTS), 1.0, 1.0), scene.motion(unknowns)
    model = LinkModel(scene.basis, scene.component, tied, scene.effects.row_changes(motion.angle, scene.pivot))
    add_links(scene.links, motion, model, state, heights, normal)

    j = scene.jacobian(unknowns)
    whole = np.einsum("kic,kij,kjd->cd", j, matrices, j)
    pull = -np.einsum("kic,kij,kj->c", j, matrices, state.residual)
    scale = np.abs(whole).max()
    assert dense(normal) == pytest.approx(whole[:SIZE, :SIZE], abs=1e-7 * scale)
    for c in range(PARTS):
        own = heights.entries[tied.at[c] : tied.at[c + 1]]
        columns = tied.columns[tied.at[c] : tied.at[c + 1]]
        assert own == pytest.approx(whole[SIZE + c, columns], abs=1e-7 * scale)
        assert np.count_nonzero(abs(whole[SIZE + c, :SIZE]) > 1e-6 * scale) <= len(own), "no coupling is left out"
    assert heights.normal - 1 == pytest.approx(np.diag(whole)[SIZE:], abs=1e-7 * scale)
    assert np.concatenate([normal.right, heights.right]) == pytest.approx(pull, abs=1e-7 * np.abs(pull).max())

    full = np.linalg.solve(whole + np.eye(TOTAL), pull)
    right = normal.right.copy()
    add_equations(np.arange(SIZE)[None], np.eye(SIZE)[None], np.zeros((1, SIZE)), normal)
    assert (normal.right == right).all()
    eliminate_heights(tied, heights, normal)
    delta = np.asarray(np.linalg.solve(dense(normal), normal.right), dtype=np.float64)
    assert delta == pytest.approx(full[:SIZE], rel=1e-5)
    assert tied.changes(heights, delta) == pytest.approx(full[SIZE:], rel=1e-5)


def test_links_whose_patches_cover_one_another_weigh_together_as_much_as_one(scene: Scene) -> None:
    covered = replace(scene, links=scene.links._replace(overlap=np.full(LINKS, 4.0)))
    one, each = (weights_of(s, NONE_RAISED, np.zeros(2)) for s in (scene, covered))
    assert 4 * each.weight == pytest.approx(one.weight)
    assert each.sigma.tolist() == one.sigma.tolist(), "an outlier is recognised by its own noise"


def weights_of(
    scene: Scene,
    raised: NDArray[np.bool_],
    residual: Array,
    scatter_mm: Array = FLAT,
    cell: NDArray[np.int_] = BARE,
    common_mm: float = 0.2,
    plainly: float = np.inf,
) -> LinkState:
    """Compute the weights of links whose residual changes by 0.1 mm in x per mm of height."""
    state = LinkState.of(scene.links, movable=False)
    state.residual[:], state.lean[:] = residual, (0.1, 0.0)
    kind, floor, common = np.zeros(LINKS, np.int_), np.array([0.01]), np.full(LINKS, common_mm)
    noise = NoiseModel(kind, floor, np.array([0.0]), 2.0, 6.0, raised, scatter_mm, cell, common, plainly)
    compute_weights(scene.links, noise, state)
    return state


def test_only_a_point_above_the_modelled_height_loses_weight_along_its_lean(scene: Scene) -> None:
    """A point 0.5 mm above the board is explained by a height of its own; one below the board is an error."""
    every = np.ones(LINKS, np.bool_)
    above, below = np.array([-0.05, 0.0]), np.array([0.05, 0.0])
    plain, raised = weights_of(scene, NONE_RAISED, above), weights_of(scene, every, above)
    assert (raised.weight[:, 0] < 0.1 * plain.weight[:, 0] / np.maximum(plain.robust, 1e-9)).all()
    assert (raised.robust == 1).all(), "the height explains the residual: it is no outlier"
    assert raised.weight[:, 2] == pytest.approx(weights_of(scene, NONE_RAISED, np.zeros(2)).weight[:, 2])
    for state in ("sigma", "robust", "weight"):
        values = [getattr(weights_of(scene, flags, below), state) for flags in (every, NONE_RAISED)]
        assert values[0] == pytest.approx(values[1])


def test_links_on_one_component_never_weigh_more_along_the_lean_than_their_common_height_allows(scene: Scene) -> None:
    still, body, cell = np.zeros(2), np.full(LINKS, 0.3), np.arange(LINKS) % 2 - 1
    plain, tied = weights_of(scene, NONE_RAISED, still, body), weights_of(scene, NONE_RAISED, still, body, cell, 0.2)
    on = cell >= 0
    assert tied.weight[on, 0].sum() == pytest.approx(1 / (1 / plain.weight[on, 0].sum() + 0.02**2))
    assert tied.weight[~on] == pytest.approx(plain.weight[~on])
    assert tied.weight[:, 1:] == pytest.approx(plain.weight[:, 1:])
