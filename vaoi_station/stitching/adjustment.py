"""One adjustment of a run: the motion of all rows, and C, from all links and sightings at once.

Unknowns are three per row (φ_j, s_j), four of the similarity C once fiducials are assigned, the
coefficients of the board's surface where it is asked for, and a height for every component that has
links of its own. The paper chains rows (equations 11–16) and adds up their errors; here every link
counts once, robustly, by iteratively reweighted Gauss-Newton.

Heights enter linearly: a ground point moves by its lean per mm. Heights of components are eliminated
from the normal equations (each is tied only to its own links).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.robust import huber_weights, median_sigma
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.motion import SPEED_TOLERANCE, STEP_TOLERANCE, SWAY_MM, YAW_RAD, Motion
from vaoi_station.stitching.observations import Ints, Observations

_ITERATIONS = 15
_CONVERGED_MM = 2e-6
_KNEE = 2.0
"""Residuals beyond so many standard deviations lose weight (Huber) …"""
_CUT = 6.0
"""… and beyond so many count no more."""
_PAIR_SIGMA_PX = 0.006
"""What the links of one pair of frames share and does not average out (interpolation, light, calibration)."""
_FLOOR_PX = (0.010, 5.0)
"""Range of the scatter of single links beyond image noise."""
_HEIGHT_SIGMA_MM = 3.0
_FIDUCIAL_SIGMA_PX = 0.020
"""What sightings scatter beyond their own standard deviation."""
_SCALE_SIGMA = 3e-4
"""How far a board may be shrunk or stretched against its CAD data (1 σ, relative)."""


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """Sightings assigned to fiducials: row, ground place, lean, CAD place (mm, right-handed as seen), sigma."""

    row: Ints
    ground_mm: Floats
    lean: Floats
    cad: Floats
    """(k, 2) CAD coordinates, y already flipped where the mapping mirrors."""
    sigma_mm: Floats
    px_per_mm: Floats


@dataclass(frozen=True, eq=False)
class SurfaceBasis:
    """Basis functions of the board's height: values per link and sighting, prior sigmas in mm."""

    at_links: Floats
    """(k, f)."""
    at_fiducials: Floats
    sigma_mm: Floats


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that is observed or known beforehand."""

    times_s: Floats
    velocity_mm_s: Floats
    links: Observations
    component: Ints
    """(k,) number of the component a link lies on, −1 for the bare board."""
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0
    surface: SurfaceBasis | None = None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The solution and how far it can be trusted."""

    motion: Motion
    similarity: Floats | None
    """(4,) a, b, x, y: board = [a −b; b a]·cad + (x, y)."""
    surface_mm: Floats
    heights_mm: Floats
    """(number of components,); NaN where no link tells."""
    covariance: Floats
    """Of the unknowns: rows 1 … m−1 (φ, sx, sy), then C, then the surface."""
    link_sigma: Floats
    """(k,) residual of each link in standard deviations."""
    link_px: Floats
    """(k, 2) residual of each link in px, along the tester's axes."""
    weight: Floats
    """(k,) final robust weight; 0: not used."""
    fiducial_px: Floats
    """(s, 2) residuals of the sightings in px."""
    floor_px: float
    sigma0: float
    """Square root of the reduced χ² of the links."""


def adjust(problem: Problem, start: Motion, similarity: Floats | None = None) -> Adjusted:
    """Solve for all unknowns.

    Args:
        problem: observations and priors.
        start: motion to start from; right to a few px.
        similarity: C to start from, where fiducials are given.
    """
    solver = _Solver(problem, start, similarity)
    for _ in range(_ITERATIONS):
        if solver.step() < _CONVERGED_MM:
            break
    return solver.result()


class _Solver:
    def __init__(self, problem: Problem, start: Motion, similarity: Floats | None) -> None:
        self.p = problem
        self.motion = start
        self.c = similarity
        self.m = len(start.angle)
        self.f = problem.surface.at_links.shape[1] if problem.surface else 0
        self.beta = np.zeros(self.f)
        self.n_components = int(problem.component.max(initial=-1)) + 1
        self.heights = np.zeros(self.n_components)
        self.same_row = problem.links.p == problem.links.q
        self.floor_px = {False: 0.05, True: 0.05}
        self.size = 3 * self.m + (4 if problem.fiducials else 0) + self.f
        self.normal = np.eye(self.size)

    def step(self) -> float:
        """One reweighted Gauss-Newton step; returns the largest change of a shift in mm."""
        normal, right = np.zeros((self.size, self.size)), np.zeros(self.size)
        self._add_links(normal, right)
        self._add_motion(normal, right)
        self._add_fiducials(normal, right)
        if self.p.surface is not None:
            at = slice(self.size - self.f, self.size)
            normal[at, at] += np.diag(1 / self.p.surface.sigma_mm**2)
            right[at] -= self.beta / self.p.surface.sigma_mm**2
        normal[:3, :] = normal[:, :3] = 0
        normal[:3, :3], right[:3] = np.eye(3), 0
        self.normal = normal
        delta = np.linalg.solve(normal, right)
        rows = delta[: 3 * self.m].reshape(self.m, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.c is not None:
            self.c = self.c + delta[3 * self.m : 3 * self.m + 4]
        self.beta = self.beta + delta[self.size - self.f :]
        if self.n_components:
            self.heights = self.heights + self._height_step - self._height_coupling @ delta
        return float(np.abs(rows[:, 1:]).max())

    def _residuals(self) -> tuple[Floats, Floats]:
        """Misfit (k, 2) mm of every link, and its change per mm of height (k, 2)."""
        o, motion = self.p.links, self.motion
        lean = motion.turned(o.q, o.b_lean) - motion.turned(o.p, o.a_lean)
        return motion.board(o.q, o.b_mm) - motion.board(o.p, o.a_mm) + lean * self._link_height()[:, None], lean

    def _link_height(self) -> Floats:
        h = np.zeros(len(self.p.links))
        if self.p.surface is not None:
            h += self.p.surface.at_links @ self.beta
        if self.n_components:
            on = self.p.component >= 0
            h[on] += self.heights[self.p.component[on]]
        return h

    def _weights(self, residual: Floats) -> Floats:
        """Weight matrices (k, 2, 2) mm⁻², robust and with what a pair of frames shares taken into account."""
        o = self.p.links
        floor_px = np.where(self.same_row, self.floor_px[True], self.floor_px[False])
        scale = (floor_px / o.px_per_mm) ** 2
        information = np.linalg.inv(o.noise_mm2 + scale[:, None, None] * np.eye(2))
        chi = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", residual, information, residual), 0) / 2)
        self.sigma = chi
        self.robust = np.where(chi > _CUT, 0.0, huber_weights(chi, _KNEE))
        per_pair = np.bincount(o.group, self.robust, minlength=len(o.groups))
        share = 1 / (1 + per_pair[o.group] * (_PAIR_SIGMA_PX / floor_px) ** 2)
        return np.asarray(information * (self.robust * share)[:, None, None])

    def _update_floor(self, residual: Floats) -> None:
        """The scatter of single links, from those on the bare board (they are the ones the model should explain).

        Links between rows and between cameras have each their own: a lifted board first shows as a large
        scatter of the latter, which keeps their weight until the surface explains it.
        """
        bare = self.p.component < 0
        for kind in (False, True):
            px = (residual * self.p.links.px_per_mm[:, None])[bare & (self.same_row == kind)]
            if len(px) >= 20:
                self.floor_px[kind] = float(np.clip(median_sigma(px), *_FLOOR_PX))

    def _add_links(self, normal: Floats, right: Floats) -> None:
        o = self.p.links
        if not len(o):
            return
        residual, lean = self._residuals()
        self._update_floor(residual)
        w = self._weights(residual)
        jp, jq = -_row_jacobian(self.motion, o.p, o.a_mm), _row_jacobian(self.motion, o.q, o.b_mm)
        j = np.concatenate([jp, jq], 2)
        if self.p.surface is not None:
            j = np.concatenate([j, lean[:, :, None] * self.p.surface.at_links[:, None, :]], 2)
        wj, wr = w @ j, (w @ residual[:, :, None])[:, :, 0]
        blocks = j.swapaxes(1, 2) @ wj
        rights = -(j.swapaxes(1, 2) @ wr[:, :, None])[:, :, 0]
        pair = o.p * self.m + o.q
        order = np.argsort(pair, kind="stable")
        starts = np.flatnonzero(np.r_[True, np.diff(pair[order]) > 0])
        for pq, block, r in zip(
            pair[order][starts],
            np.add.reduceat(blocks[order], starts),
            np.add.reduceat(rights[order], starts),
            strict=True,
        ):
            at = self._columns(pq // self.m, pq % self.m)
            np.add.at(normal, np.ix_(at, at), block)
            np.add.at(right, at, r)
        self._eliminate_heights(normal, right, w, lean, wj, wr)

    def _columns(self, p: int, q: int) -> Ints:
        tail = np.arange(self.size - self.f, self.size)
        return np.concatenate([np.arange(3 * p, 3 * p + 3), np.arange(3 * q, 3 * q + 3), tail])

    def _eliminate_heights(
        self, normal: Floats, right: Floats, w: Floats, lean: Floats, wj: Floats, wr: Floats
    ) -> None:
        """Schur complement of the component heights."""
        if not self.n_components:
            return
        o, on = self.p.links, self.p.component >= 0
        c, n = self.p.component[on], self.n_components
        lean = lean[on]
        hh = np.bincount(c, np.einsum("ki,kij,kj->k", lean, w[on], lean), minlength=n) + 1 / _HEIGHT_SIGMA_MM**2
        rh = -np.bincount(c, np.einsum("ki,ki->k", lean, wr[on]), minlength=n) - self.heights / _HEIGHT_SIGMA_MM**2
        cross = np.einsum("ki,kif->kf", lean, wj[on])
        b = np.zeros((n, self.size))
        tail = np.arange(self.size - self.f, self.size)
        for part, columns in ((0, 3 * o.p[on]), (3, 3 * o.q[on])):
            for k in range(3):
                np.add.at(b, (c, columns + k), cross[:, part + k])
        for k, column in enumerate(tail):
            np.add.at(b, (c, column), cross[:, 6 + k])
        b[:, :3] = 0
        self._height_step, self._height_coupling = rh / hh, b / hh[:, None]
        normal -= b.T @ self._height_coupling
        right -= b.T @ self._height_step

    def _add_motion(self, normal: Floats, right: Floats) -> None:
        """The belt's nominal motion as a measurement: rows nobody sees stay where the belt puts them."""
        m, t = self.m, self.p.times_s
        if m < 2:
            return
        dt = np.diff(t)
        velocity = self._belt(dt)
        along = velocity / max(float(np.hypot(*velocity)), 1e-9)
        step_mm = np.maximum(np.abs(dt) * float(np.hypot(*velocity)), 1e-3)
        for j in range(m - 1):
            sigma_along = STEP_TOLERANCE * step_mm[j] + 0.01
            weight = np.outer(along, along) / sigma_along**2 + (np.eye(2) - np.outer(along, along)) / SWAY_MM**2
            misfit = self.motion.shift[j + 1] - self.motion.shift[j] + velocity * dt[j]
            a, b = np.arange(3 * j + 1, 3 * j + 3), np.arange(3 * j + 4, 3 * j + 6)
            for x, y, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                normal[np.ix_(x, y)] += sign * weight
            right[a] += weight @ misfit
            right[b] -= weight @ misfit
            turn = self.motion.angle[j + 1] - self.motion.angle[j]
            k, n = 3 * j, 3 * j + 3
            w = 1 / YAW_RAD**2
            normal[k, k] += w
            normal[n, n] += w
            normal[k, n] -= w
            normal[n, k] -= w
            right[k] += w * turn
            right[n] -= w * turn

    def _belt(self, dt: Floats) -> Floats:
        """The mean velocity: of the steps that links measure, drawn to the nominal one."""
        o = self.p.links
        measured = np.zeros(self.m - 1, dtype=bool)
        for pair in np.unique(o.p * self.m + o.q) if len(o) else ():
            measured[pair // self.m : pair % self.m] = True
        nominal, n = self.p.velocity_mm_s, int(measured.sum())
        if not n:
            return nominal
        steps = -np.diff(self.motion.shift, axis=0)[measured] / dt[measured, None]
        prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
        return np.asarray((steps.sum(0) + prior * nominal) / (n + prior))

    def _add_fiducials(self, normal: Floats, right: Floats) -> None:
        s = self.p.fiducials
        if s is None or self.c is None:
            return
        residual, j = self._fiducial_terms(s)
        sigma = np.hypot(s.sigma_mm, _FIDUCIAL_SIGMA_PX / s.px_per_mm)
        chi = np.sqrt((residual**2).sum(1) / 2) / sigma
        weight = huber_weights(chi, _KNEE) / sigma**2
        for k in range(len(s.row)):
            at = np.concatenate([np.arange(3 * s.row[k], 3 * s.row[k] + 3), np.arange(3 * self.m, self.size)])
            normal[np.ix_(at, at)] += weight[k] * j[k].T @ j[k]
            right[at] -= weight[k] * j[k].T @ residual[k]
        a, b = self.c[:2]
        scale = float(np.hypot(a, b))
        gradient = np.array([a, b]) / scale
        w = 1 / (_SCALE_SIGMA * self.p.nominal_scale) ** 2
        at = np.arange(3 * self.m, 3 * self.m + 2)
        normal[np.ix_(at, at)] += w * np.outer(gradient, gradient)
        right[at] -= w * (scale - self.p.nominal_scale) * gradient

    def _fiducial_terms(self, s: FiducialPoints) -> tuple[Floats, Floats]:
        """Misfit (s, 2) mm of the sightings, and its Jacobian for row, C and surface (s, 2, 3 + 4 + f)."""
        assert self.c is not None
        height = self.p.surface.at_fiducials @ self.beta if self.p.surface else np.zeros(len(s.row))
        lean = self.motion.turned(s.row, s.lean)
        residual = self.motion.board(s.row, s.ground_mm) + lean * height[:, None] - similar(self.c, s.cad)
        parts = [_row_jacobian(self.motion, s.row, s.ground_mm), -similar_jacobian(s.cad)]
        if self.p.surface is not None:
            parts.append(lean[:, :, None] * self.p.surface.at_fiducials[:, None, :])
        return residual, np.concatenate(parts, 2)

    def result(self) -> Adjusted:
        o, s = self.p.links, self.p.fiducials
        covariance = np.asarray(np.linalg.inv(self.normal), dtype=np.float64)
        covariance[:3] = covariance[:, :3] = 0
        used, sigma, px = np.zeros(0), np.zeros(0), np.zeros((0, 2))
        sigma0 = 1.0
        if len(o):
            residual, _ = self._residuals()
            self._weights(residual)
            used, sigma = self.robust, self.sigma
            px = residual * o.px_per_mm[:, None]
            sigma0 = float(np.sqrt(np.average(sigma**2, weights=np.maximum(used, 1e-9))))
        heights = np.full(self.n_components, np.nan)
        told = np.bincount(self.p.component[self.p.component >= 0], minlength=self.n_components) >= 3
        heights[told] = self.heights[told]
        fiducial_px = np.zeros((0, 2))
        if s is not None and self.c is not None:
            fiducial_px = self._fiducial_terms(s)[0] * s.px_per_mm[:, None]
        return Adjusted(
            self.motion,
            self.c,
            self.beta,
            heights,
            covariance,
            sigma,
            px,
            used,
            fiducial_px,
            self.floor_px[False],
            sigma0,
        )


def similar(c: Floats, cad: Floats) -> Floats:
    """Board points of CAD points (k, 2) by the similarity (a, b, x, y)."""
    a, b, x, y = c
    return np.stack([a * cad[:, 0] - b * cad[:, 1] + x, b * cad[:, 0] + a * cad[:, 1] + y], -1)


def similar_jacobian(cad: Floats) -> Floats:
    """Derivative (k, 2, 4) of `similar` by (a, b, x, y)."""
    x, y, one, nil = cad[:, 0], cad[:, 1], np.ones(len(cad)), np.zeros(len(cad))
    return np.stack([np.stack([x, -y, one, nil], -1), np.stack([y, x, nil, one], -1)], 1)


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Derivative (k, 2, 3) of a board point by (φ, sx, sy) of its row."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)
