"""The compiled passes over the links against numpy, one link at a time, derivatives by differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.envelope import Envelope, add
from vaoi_station.stitching.adjustment.link_equations import (
    Coupling,
    accumulate,
    eliminate,
    heights_moved,
    misfits,
    weigh,
)

Array = NDArray[np.float64]
ROWS, LINKS, BASIS, PARTS = 4, 60, 3, 5


@dataclass
class Scene:
    p: NDArray[np.int_]
    q: NDArray[np.int_]
    a: Array
    b: Array
    a_lean: Array
    b_lean: Array
    basis: Array
    component: NDArray[np.int_]
    pivot: Array

    def misfit(self, unknowns: Array) -> Array:
        """(k, 2) from rows (φ, sx, sy), surface and heights in one vector."""
        rows = unknowns[: 3 * ROWS].reshape(ROWS, 3)
        beta, heights = unknowns[3 * ROWS : 3 * ROWS + BASIS], unknowns[3 * ROWS + BASIS :]
        out = []
        for n in range(len(self.p)):
            h = self.basis[n] @ beta + (heights[self.component[n]] if self.component[n] >= 0 else 0.0)
            board, lean = [], []
            for row, at, of in ((self.q[n], self.b[n], self.b_lean[n]), (self.p[n], self.a[n], self.a_lean[n])):
                c, s = np.cos(rows[row, 0]), np.sin(rows[row, 0])
                turn = np.array([[c, -s], [s, c]])
                board.append(turn @ (at - self.pivot) + self.pivot + rows[row, 1:])
                lean.append(turn @ of)
            out.append(board[0] - board[1] + (lean[0] - lean[1]) * h)
        return np.array(out)


@pytest.fixture
def scene() -> Scene:
    g = np.random.default_rng(3)
    p = np.sort(g.integers(0, ROWS - 1, LINKS))
    q = np.where(np.arange(LINKS) % 2, p, p + 1)
    order = np.lexsort((q, p))
    return Scene(
        p[order],
        q[order],
        g.normal(0, 10, (LINKS, 2)),
        g.normal(0, 10, (LINKS, 2)),
        g.normal(0, 0.02, (LINKS, 2)),
        g.normal(0, 0.02, (LINKS, 2)),
        g.normal(0, 1, (LINKS, BASIS)),
        g.integers(-1, PARTS, LINKS),
        np.array([3.0, -2.0]),
    )


def groups(scene: Scene) -> NDArray[np.int_]:
    pair = scene.p * ROWS + scene.q
    return np.concatenate([[0], np.cumsum(np.diff(pair) != 0)])


def found(scene: Scene, unknowns: Array) -> tuple[Array, Array]:
    rows = unknowns[: 3 * ROWS].reshape(ROWS, 3)
    heights = np.append(unknowns[3 * ROWS + BASIS :], 0.0)
    height = scene.basis @ unknowns[3 * ROWS : 3 * ROWS + BASIS] + heights[scene.component]
    residual, lean = np.empty((LINKS, 2)), np.empty((LINKS, 2))
    s = scene
    angle, shift = np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1:])
    misfits(s.p, s.q, s.a, s.b, s.a_lean, s.b_lean, height, angle, shift, s.pivot, residual, lean)
    return residual, lean


def test_the_misfit_of_a_link(scene: Scene) -> None:
    unknowns = np.random.default_rng(4).normal(0, 0.1, 3 * ROWS + BASIS + PARTS)
    assert found(scene, unknowns)[0] == pytest.approx(scene.misfit(unknowns), abs=1e-12)


def test_normal_equations_are_those_of_the_linearised_misfits(scene: Scene) -> None:
    size, total = 3 * ROWS + BASIS, 3 * ROWS + BASIS + PARTS
    unknowns = np.zeros(total)
    unknowns[:size] = np.random.default_rng(5).normal(0, 0.05, size)
    unknowns[3 * ROWS : size] = 0  # at no height turning a row does not turn a lean, which the equations leave out
    g = np.random.default_rng(6)
    root = g.normal(0, 1, (LINKS, 2, 2))
    matrices = root @ root.swapaxes(1, 2)
    weight = np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], -1)
    residual, lean = found(scene, unknowns)
    s = scene
    tied = Coupling.of(s.component, s.p, s.q, PARTS, BASIS)
    envelope = Envelope.of(np.full(ROWS, ROWS - 1), BASIS)
    values, right = np.zeros(envelope.entries), np.zeros(size)
    coupling, height_normal, height_right = np.zeros(tied.at[-1]), np.ones(PARTS), np.zeros(PARTS)
    angle = np.ascontiguousarray(unknowns[: 3 * ROWS : 3])
    accumulate(
        *(s.p, s.q, s.a, s.b, groups(s), angle, s.pivot, residual, lean, weight, s.basis, s.component),
        *(envelope.at, values, right, tied.row, tied.at, coupling, height_normal, height_right),
    )
    step = 1e-6
    eye = np.eye(total) * step
    j = np.stack([(s.misfit(unknowns + d) - s.misfit(unknowns - d)) / (2 * step) for d in eye], -1)
    whole = np.einsum("kic,kij,kjd->cd", j, matrices, j)
    pull = -np.einsum("kic,kij,kj->c", j, matrices, residual)
    scale = np.abs(whole).max()
    assert envelope.dense(values) == pytest.approx(whole[:size, :size], abs=1e-7 * scale)
    for c in range(PARTS):
        own = coupling[tied.at[c] : tied.at[c + 1]]
        expected = np.append(whole[size + c, 3 * tied.row[c] : 3 * tied.last[c] + 3], whole[size + c, 3 * ROWS : size])
        assert own == pytest.approx(expected, abs=1e-7 * scale)
        assert np.count_nonzero(abs(whole[size + c, :size]) > 1e-6 * scale) <= len(own), "nothing is left out"
    assert height_normal - 1 == pytest.approx(np.diag(whole)[size:], abs=1e-7 * scale)
    assert np.concatenate([right, height_right]) == pytest.approx(pull, abs=1e-7 * np.abs(pull).max())

    full = np.linalg.solve(whole + np.eye(total), pull)
    heights = (tied.row, tied.at, BASIS, coupling, height_normal, height_right)
    add(np.arange(size)[None], np.eye(size)[None], np.zeros((1, size)), envelope.at, values, np.zeros(size))
    eliminate(*heights, envelope.at, values, right)
    delta = np.asarray(np.linalg.solve(envelope.dense(values), right), dtype=np.float64)
    assert delta == pytest.approx(full[:size], rel=1e-5)
    assert heights_moved(*heights, delta) == pytest.approx(full[size:], rel=1e-5)


def test_a_part_without_links_is_tied_to_nothing(scene: Scene) -> None:
    tied = Coupling.of(np.where(scene.component == 2, -1, scene.component), scene.p, scene.q, PARTS, BASIS)
    assert tied.at[2] == tied.at[3]
    assert (np.diff(tied.at)[[0, 1, 3, 4]] >= 3 + BASIS).all()


def test_weights_are_those_of_noise_floor_and_size(scene: Scene) -> None:
    g = np.random.default_rng(7)
    noise = np.tile(np.diag([1e-4, 4e-4]), (LINKS, 1, 1))
    residual, kind = g.normal(0, 0.1, (LINKS, 2)), (scene.p == scene.q).astype(np.int_)
    floor, shared, px = np.array([0.3, 0.6]), np.array([0.1, 0.2]), np.full(LINKS, 20.0)
    sigma, robust, weight = np.empty(LINKS), np.empty(LINKS), np.empty((LINKS, 3))
    group = groups(scene)
    weigh(residual, noise, px, group, int(group.max()) + 1, kind, floor, shared, 2.0, 6.0, sigma, robust, weight)
    information = 1 / (np.array([1e-4, 4e-4]) + ((floor[kind] / px) ** 2)[:, None])
    chi = np.sqrt((residual**2 * information).sum(1) / 2)
    assert sigma == pytest.approx(chi)
    assert (chi > 6).any()
    assert ((chi > 2) & (chi < 6)).any()
    assert robust == pytest.approx(np.where(chi > 6, 0, np.where(chi > 2, 2 / chi, 1)))
    told = np.bincount(group, robust * information.mean(1))
    share = 1 / (1 + told[group] * (shared[kind] / px) ** 2)
    assert weight == pytest.approx((robust * share)[:, None] * information[:, [0, 0, 1]] * (1, 0, 1))
