"""The links of a run as normal equations: one compiled pass over all of them per step of the adjustment.

A link says that ground point a of row p and ground point b of row q are the same point of the board. Its misfit is

    r = board(q, b) − board(p, a) + l·h,    l = R(φ_q)·l_b − R(φ_p)·l_a,

l being how far it moves per mm of height and h the height of what it lies on: surface plus component. Unknowns are
(φ, sx, sy) of every row, in the columns 3·row …, and the coefficients of the surface in the last ones; the normal
matrix is kept in its envelope (`envelope.py`). Heights of components have normal equations of their own, each tied
only to the rows that see it and to the surface (`Coupling`), and are eliminated (`eliminate`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Coupling:
    """Which unknowns the heights of c components are tied to: rows that follow one another, then the surface."""

    row: Ints
    """(c,) the first row."""
    last: Ints
    """(c,) the last row; −1 without links."""
    at: Ints
    """(c + 1,) where the entries of each begin: (φ, sx, sy) of its rows, then the surface's coefficients."""

    @staticmethod
    def of(component: Ints, p: Ints, q: Ints, count: int, surface: int) -> Coupling:
        """By the component (k,) of every link, or −1, and by its rows p ≤ q."""
        first, last = _rows_that_see(component, p, q, count)
        widths = np.where(last >= 0, 3 * (last - first + 1) + surface, 0)
        return Coupling(first, last, np.append(0, np.cumsum(widths)))


@compiled
def _rows_that_see(component: Ints, p: Ints, q: Ints, count: int) -> tuple[Ints, Ints]:
    """First and last row (c,) of each component's links; 0 and −1 without any."""
    first, last = np.zeros(count, np.int64), np.full(count, -1)
    for n in range(len(component)):
        c = component[n]
        if c >= 0:
            low, high = min(p[n], q[n]), max(p[n], q[n])
            first[c] = low if last[c] < 0 else min(first[c], low)
            last[c] = max(last[c], high)
    return first, last


@compiled
def misfits(
    p: Ints,
    q: Ints,
    a_mm: Floats,
    b_mm: Floats,
    a_lean: Floats,
    b_lean: Floats,
    height_mm: Floats,
    angle: Floats,
    shift: Floats,
    pivot: Floats,
    residual: Floats,
    lean: Floats,
) -> None:
    """Misfit of every link, and how it changes with height.

    Args:
        p: (k,) row of the first point.
        q: (k,) row of the second.
        a_mm: (k, 2) first point on the ground.
        b_mm: (k, 2) second point.
        a_lean: (k, 2) mm per mm of height by which the first point lies elsewhere.
        b_lean: (k, 2) the same of the second.
        height_mm: (k,) above the calibrated plane.
        angle: (m,) of the rows, rad.
        shift: (m, 2) mm.
        pivot: (2,) mm.
        residual: out, (k, 2) mm.
        lean: out, (k, 2).
    """
    cos, sin = np.cos(angle), np.sin(angle)
    for n in range(len(p)):
        i, j = p[n], q[n]
        ax, ay, bx, by = a_mm[n, 0] - pivot[0], a_mm[n, 1] - pivot[1], b_mm[n, 0] - pivot[0], b_mm[n, 1] - pivot[1]
        lx = cos[j] * b_lean[n, 0] - sin[j] * b_lean[n, 1] - cos[i] * a_lean[n, 0] + sin[i] * a_lean[n, 1]
        ly = sin[j] * b_lean[n, 0] + cos[j] * b_lean[n, 1] - sin[i] * a_lean[n, 0] - cos[i] * a_lean[n, 1]
        dx = cos[j] * bx - sin[j] * by + shift[j, 0] - cos[i] * ax + sin[i] * ay - shift[i, 0]
        dy = sin[j] * bx + cos[j] * by + shift[j, 1] - sin[i] * ax - cos[i] * ay - shift[i, 1]
        residual[n, 0], residual[n, 1] = dx + lx * height_mm[n], dy + ly * height_mm[n]
        lean[n, 0], lean[n, 1] = lx, ly


@compiled
def weigh(
    residual: Floats,
    noise_mm2: Floats,
    px_per_mm: Floats,
    group: Ints,
    groups: int,
    kind: Ints,
    floor_px: Floats,
    shared_px: Floats,
    knee: float,
    cut: float,
    sigma: Floats,
    robust: Floats,
    weight: Floats,
) -> None:
    """Robust weights of links, those of one pair of frames together no surer than what they share.

    Args:
        residual: (k, 2) mm.
        noise_mm2: (k, 2, 2) covariance by image noise.
        px_per_mm: (k,).
        group: (k,) number of the pair of frames.
        groups: how many there are.
        kind: (k,) which of `floor_px` and `shared_px` counts.
        floor_px: what single links scatter beyond noise, by kind.
        shared_px: what the links of a pair share, by kind.
        knee: residuals beyond so many standard deviations lose weight (Huber).
        cut: those beyond so many have none.
        sigma: out, (k,) size of the residual in standard deviations.
        robust: out, (k,) 0 … 1.
        weight: out, (k, 3) weight matrix, xx, xy, yy, mm⁻².
    """
    told = np.zeros(groups)
    for n in range(len(residual)):
        floor = (floor_px[kind[n]] / px_per_mm[n]) ** 2
        a, b, d = noise_mm2[n, 0, 0] + floor, noise_mm2[n, 0, 1], noise_mm2[n, 1, 1] + floor
        determinant = a * d - b * b
        xx, xy, yy = d / determinant, -b / determinant, a / determinant
        x, y = residual[n, 0], residual[n, 1]
        sigma[n] = math.sqrt(max(xx * x * x + 2 * xy * x * y + yy * y * y, 0.0) / 2)
        robust[n] = 1.0 if sigma[n] <= knee else knee / sigma[n] if sigma[n] <= cut else 0.0
        weight[n, 0], weight[n, 1], weight[n, 2] = robust[n] * xx, robust[n] * xy, robust[n] * yy
        told[group[n]] += (weight[n, 0] + weight[n, 2]) / 2
    for n in range(len(residual)):
        share = 1 / (1 + told[group[n]] * (shared_px[kind[n]] / px_per_mm[n]) ** 2)
        for i in range(3):
            weight[n, i] *= share


@compiled
def accumulate(
    p: Ints,
    q: Ints,
    a_mm: Floats,
    b_mm: Floats,
    group: Ints,
    angle: Floats,
    pivot: Floats,
    residual: Floats,
    lean: Floats,
    weight: Floats,
    basis: Floats,
    component: Ints,
    at: Ints,
    values: Floats,
    right: Floats,
    tied_row: Ints,
    tied_at: Ints,
    coupling: Floats,
    height_normal: Floats,
    height_right: Floats,
) -> None:
    """Add the links to the normal equations.

    Args:
        p: as in `misfits`, as are q, a_mm, b_mm, angle, pivot, residual and lean.
        group: (k,) links of one group stand together and have the same p and q.
        weight: (k, 3) as of `weigh`.
        basis: (k, f) values of the surface's basis functions; f may be 0.
        component: (k,) number of the height a link tells of, or −1.
        at: of the envelope.
        values: in and out, of the envelope.
        right: in and out, (n,).
        tied_row: `row` of the `Coupling`.
        tied_at: `at` of the same.
        coupling: in and out, its entries.
        height_normal: in and out, (c,).
        height_right: in and out, (c,).
    """
    cos, sin = np.cos(angle), np.sin(angle)
    f, size = basis.shape[1], len(right)
    width = 6 + f
    columns = np.zeros(width, np.int64)
    square, product = np.zeros((width, width)), np.zeros(width)
    columns[6:] = np.arange(size - f, size)
    most = _longest(group)
    at_lift, bases, count = np.empty((6, most)), np.empty((f, most)), 0
    for n in range(len(p)):
        i, j = p[n], q[n]
        ax, ay, bx, by = a_mm[n, 0] - pivot[0], a_mm[n, 1] - pivot[1], b_mm[n, 0] - pivot[0], b_mm[n, 1] - pivot[1]
        # the misfit's change with φ_p and φ_q; with the shifts it is −1 and 1
        px, py = sin[i] * ax + cos[i] * ay, -cos[i] * ax + sin[i] * ay
        qx, qy = -sin[j] * bx - cos[j] * by, cos[j] * bx - sin[j] * by
        lx, ly = lean[n, 0], lean[n, 1]
        xx, xy, yy = weight[n, 0], weight[n, 1], weight[n, 2]
        rx, ry = xx * residual[n, 0] + xy * residual[n, 1], xy * residual[n, 0] + yy * residual[n, 1]
        wpx, wpy, wqx, wqy = xx * px + xy * py, xy * px + yy * py, xx * qx + xy * qy, xy * qx + yy * qy
        wlx, wly = xx * lx + xy * ly, xy * lx + yy * ly
        pl, ql, ll, lr = px * wlx + py * wly, qx * wlx + qy * wly, lx * wlx + ly * wly, lx * rx + ly * ry
        product[0] += px * rx + py * ry
        product[3] += qx * rx + qy * ry
        product[4] += rx
        product[5] += ry
        square[0, 0] += px * wpx + py * wpy
        square[3, 0] += qx * wpx + qy * wpy
        square[4, 0] += wpx
        square[5, 0] += wpy
        square[3, 3] += qx * wqx + qy * wqy
        square[4, 3] += wqx
        square[5, 3] += wqy
        square[4, 4] += xx
        square[5, 4] += xy
        square[5, 5] += yy
        at_lift[0, count], at_lift[1, count], at_lift[2, count], at_lift[3, count] = pl, ql, wlx, wly
        at_lift[4, count], at_lift[5, count] = lr, ll
        for k in range(f):
            bases[k, count] = basis[n, k]
        count += 1
        c = component[n]
        if c >= 0:
            height_normal[c] += ll
            height_right[c] -= lr
            _couple(coupling, tied_at[c] + 3 * (i - tied_row[c]), pl, -wlx, -wly)
            _couple(coupling, tied_at[c] + 3 * (j - tied_row[c]), ql, wlx, wly)
            for k in range(f):
                coupling[tied_at[c + 1] - f + k] += ll * basis[n, k]
        if n + 1 == len(p) or group[n + 1] != group[n]:
            for k in range(3):
                columns[k], columns[3 + k] = 3 * i + k, 3 * j + k
            _lift(at_lift, bases, count, square, product)
            count = 0
            _pour(columns, square, product, at, values, right)


@inlined
def _longest(group: Ints) -> int:
    """How many links the largest group has."""
    most, begin = 0, 0
    for n in range(len(group)):
        if group[n] != group[begin]:
            begin = n
        most = max(most, n + 1 - begin)
    return most


@inlined
def _lift(at_lift: Floats, bases: Floats, count: int, square: Floats, product: Floats) -> None:
    """What a group's links say of the surface: sums over its links, which run in vector registers."""
    for k in range(len(bases)):
        p, q, x, y, r = 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(count):
            b = bases[k, n]
            p, q, r = p + at_lift[0, n] * b, q + at_lift[1, n] * b, r + at_lift[4, n] * b
            x, y = x + at_lift[2, n] * b, y + at_lift[3, n] * b
        product[6 + k] = r
        square[6 + k, 0], square[6 + k, 3], square[6 + k, 4], square[6 + k, 5] = p, q, x, y
        for m in range(k + 1):
            total = 0.0
            for n in range(count):
                total += at_lift[5, n] * bases[k, n] * bases[m, n]
            square[6 + k, 6 + m] = total


@inlined
def _couple(coupling: Floats, at: int, angle: float, x: float, y: float) -> None:
    coupling[at] += angle
    coupling[at + 1] += x
    coupling[at + 2] += y


@inlined
def _pour(columns: Ints, square: Floats, product: Floats, at: Ints, values: Floats, right: Floats) -> None:
    """Add what a group of links gave, and begin anew.

    What holds of row q's shift, in columns 4 and 5, holds of row p's, in columns 1 and 2, with the other sign.
    """
    width = len(columns)
    for x in range(1, 3):
        product[x] = -product[3 + x]
        square[x, 0], square[3, x] = -square[3 + x, 0], -square[3 + x, 3]
        for k in range(6, width):
            square[k, x] = -square[k, 3 + x]
    square[1, 1], square[2, 1], square[2, 2] = square[4, 4], square[5, 4], square[5, 5]
    square[4, 1], square[4, 2], square[5, 1], square[5, 2] = -square[4, 4], -square[5, 4], -square[5, 4], -square[5, 5]
    for k in range(width):
        right[columns[k]] -= product[k]
        product[k] = 0.0
        for m in range(k + 1):
            high, low = max(columns[k], columns[m]), min(columns[k], columns[m])
            values[at[high] + low] += square[k, m] * (2 if high == low and k != m else 1)
            square[k, m] = 0.0


@compiled
def eliminate(
    tied_row: Ints,
    tied_at: Ints,
    surface: int,
    coupling: Floats,
    height_normal: Floats,
    height_right: Floats,
    at: Ints,
    values: Floats,
    right: Floats,
) -> None:
    """Take the heights out of the normal equations; `surface` is how many coefficients that has."""
    for c in range(len(height_normal)):
        begin, end = tied_at[c], tied_at[c + 1]
        rows, others = end - begin - surface, len(right) - surface
        for a in range(end - begin):
            own = coupling[begin + a] / height_normal[c]
            if own != 0:
                i = 3 * tied_row[c] + a if a < rows else others + a - rows
                right[i] -= own * height_right[c]
                for b in range(a + 1):
                    j = 3 * tied_row[c] + b if b < rows else others + b - rows
                    values[at[i] + j] -= own * coupling[begin + b]


@compiled
def heights_moved(
    tied_row: Ints,
    tied_at: Ints,
    surface: int,
    coupling: Floats,
    height_normal: Floats,
    height_right: Floats,
    delta: Floats,
) -> Floats:
    """By how much the heights (c,) change once all else has changed by delta (n,)."""
    out = height_right.copy()
    for c in range(len(out)):
        begin, end = tied_at[c], tied_at[c + 1]
        rows, others = end - begin - surface, len(delta) - surface
        for a in range(end - begin):
            out[c] -= coupling[begin + a] * delta[3 * tied_row[c] + a if a < rows else others + a - rows]
        out[c] /= height_normal[c]
    return out
