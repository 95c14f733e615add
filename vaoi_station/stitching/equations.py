"""The links of a run as normal equations: one compiled pass over all of them per step of the adjustment.

A link says that ground point a of row p and ground point b of row q are the same point of the board. Its misfit is

    r = board(q, b) − board(p, a) + l·h,    l = R(φ_q)·l_b − R(φ_p)·l_a,

l being how far it moves per mm of height and h the height of what it lies on: surface plus component. Unknowns are
(φ, sx, sy) of every row, in the columns 3·row …, and the coefficients of the surface in the last ones;
heights of components have normal equations of their own, each tied only to its own links, and are
eliminated (`eliminate`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
Bools = NDArray[np.bool_]


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
    normal: Floats,
    right: Floats,
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
        normal: in and out, (size, size).
        right: in and out, (size,).
        coupling: in and out, (c, size) between heights and the other unknowns.
        height_normal: in and out, (c,).
        height_right: in and out, (c,).
    """
    cos, sin = np.cos(angle), np.sin(angle)
    f, size = basis.shape[1], len(right)
    width = 6 + f
    gx, gy, columns = np.zeros(width), np.zeros(width), np.zeros(width, np.int64)
    square, product = np.zeros((width, width)), np.zeros(width)
    gx[1], gy[2], gx[4], gy[5] = -1.0, -1.0, 1.0, 1.0
    columns[6:] = np.arange(size - f, size)
    for n in range(len(p)):
        i, j = p[n], q[n]
        ax, ay, bx, by = a_mm[n, 0] - pivot[0], a_mm[n, 1] - pivot[1], b_mm[n, 0] - pivot[0], b_mm[n, 1] - pivot[1]
        gx[0], gy[0] = sin[i] * ax + cos[i] * ay, -cos[i] * ax + sin[i] * ay
        gx[3], gy[3] = -sin[j] * bx - cos[j] * by, cos[j] * bx - sin[j] * by
        for k in range(f):
            gx[6 + k], gy[6 + k] = lean[n, 0] * basis[n, k], lean[n, 1] * basis[n, k]
        xx, xy, yy = weight[n, 0], weight[n, 1], weight[n, 2]
        rx = xx * residual[n, 0] + xy * residual[n, 1]
        ry = xy * residual[n, 0] + yy * residual[n, 1]
        for k in range(width):
            wx, wy = xx * gx[k] + xy * gy[k], xy * gx[k] + yy * gy[k]
            product[k] += gx[k] * rx + gy[k] * ry
            for m in range(k + 1):
                square[k, m] += wx * gx[m] + wy * gy[m]
        for k in range(3):
            columns[k], columns[3 + k] = 3 * i + k, 3 * j + k
        c = component[n]
        if c >= 0:
            lx, ly = lean[n, 0], lean[n, 1]
            wx, wy = xx * lx + xy * ly, xy * lx + yy * ly
            height_normal[c] += wx * lx + wy * ly
            height_right[c] -= lx * rx + ly * ry
            for k in range(width):
                coupling[c, columns[k]] += wx * gx[k] + wy * gy[k]
        if n + 1 == len(p) or group[n + 1] != group[n]:
            for k in range(width):
                right[columns[k]] -= product[k]
                product[k] = 0.0
                for m in range(k):
                    normal[columns[k], columns[m]] += square[k, m]
                    normal[columns[m], columns[k]] += square[k, m]
                    square[k, m] = 0.0
                normal[columns[k], columns[k]] += square[k, k]
                square[k, k] = 0.0


@compiled
def eliminate(coupling: Floats, height_normal: Floats, height_right: Floats, normal: Floats, right: Floats) -> None:
    """Take the heights out of the normal equations: each has a few columns only."""
    columns = np.zeros(len(right), np.int64)
    for c in range(len(height_normal)):
        count = 0
        for k in range(len(right)):
            if coupling[c, k] != 0:
                columns[count] = k
                count += 1
        for a in range(count):
            own = coupling[c, columns[a]] / height_normal[c]
            right[columns[a]] -= own * height_right[c]
            for b in range(count):
                normal[columns[a], columns[b]] -= own * coupling[c, columns[b]]
