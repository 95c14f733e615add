"""The board's height above the calibrated plane: lift, tilt and bow.

A board thicker than the calibration board, or bowed, is the largest error of the planar model. What
one camera sees from row to row cannot tell a higher board from a faster belt; the overlap with its
neighbour, whose baseline is in N_i, and the CAD distance of the fiducials can. The surface is a
polynomial of second degree in u, v = −1 … 1 over the board; a poorly seen coefficient stays near zero.
"""

from __future__ import annotations

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Surface

SIGMA_MM = np.array([1.0, 0.08, 0.08, 0.3, 0.1, 0.3])
"""Prior standard deviation of lift, tilt along u and v, and the coefficients of u², uv, v²."""

_EDGE = 1.2


def basis(board_type: BoardType, cad: Floats) -> Floats:
    """Values (k, 6) of the basis functions at CAD points (k, 2)."""
    return _basis(np.eye(3), np.ascontiguousarray(cad, dtype=np.float64), *frame_of(board_type))


def basis_at_board(board_type: BoardType, cad_matrix: Floats, board_mm: Floats) -> Floats:
    """The same for points (k, 2) of the board in tester coordinates."""
    cad_from_board = np.ascontiguousarray(np.linalg.inv(cad_matrix), dtype=np.float64)
    return _basis(cad_from_board, np.ascontiguousarray(board_mm), *frame_of(board_type))


@compiled
def _basis(cad_from_place: Floats, place: Floats, about: Floats, half: Floats) -> Floats:
    """By an affine map (3, 3) from places (k, 2) to CAD; a little beyond the board the functions stay what they are."""
    m, out = cad_from_place, np.empty((len(place), 6))
    for n in range(len(place)):
        x, y = place[n, 0], place[n, 1]
        u = min(max((m[0, 0] * x + m[0, 1] * y + m[0, 2] - about[0]) / half[0], -_EDGE), _EDGE)
        v = min(max((m[1, 0] * x + m[1, 1] * y + m[1, 2] - about[1]) / half[1], -_EDGE), _EDGE)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4], out[n, 5] = 1.0, u, v, u * u, u * v, v * v
    return out


def frame_of(board_type: BoardType) -> tuple[Floats, Floats]:
    """Middle and half span of the board in CAD units: where u and v are 0 and 1."""
    low, high = board_type.extent()
    return (low + high) / 2, np.maximum((high - low) / 2, 1e-9)


def to_surface(board_type: BoardType, coefficients_mm: Floats) -> Surface:
    """The surface as results carry it."""
    about, half = frame_of(board_type)
    c = [round(float(v), 5) for v in coefficients_mm]
    return Surface(
        lift_mm=c[0],
        tilt_mm=(c[1], c[2]),
        bow_mm=(c[3], c[4], c[5]),
        about=(float(about[0]), float(about[1])),
        half_span=(float(half[0]), float(half[1])),
    )
