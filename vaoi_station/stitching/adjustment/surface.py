"""The surface: the height of the board above the calibrated plane, described by lift, tilt and bow.

The largest error of the planar model comes from boards that are bowed, or thicker than the calibration board. From the
links of one camera between rows, a higher board cannot be distinguished from a faster belt. Two other observations do:
links to the neighbouring camera, whose position is known from N_i, and the distance between fiducials, which is known
from CAD.

The surface is a polynomial of second degree in u and v, which run from −1 to 1 over the board. Priors keep a
coefficient near 0 if it is poorly observed.
"""

from __future__ import annotations

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Surface

SIGMA_MM = np.array([1.0, 0.08, 0.08, 0.3, 0.1, 0.3])
"""(6,) prior standard deviations of the coefficients, mm: lift, tilt along u, tilt along v, and bow (u², uv, v²)."""

_KINDS = (slice(1, 3), slice(3, 6))
"""Coefficients with heavy tails that occur together: tilt and bow. A board that is tilted along u may as well be along
v. The lift has none: rails and depth of field leave no room for one of many millimetres, which would otherwise explain
a turned camera with a single seam."""
_FREEDOM = 4.0
"""Degrees of freedom of the t distribution of each kind: a board that lies on something is tilted by far more."""

_EDGE = 1.2
"""Largest |u| and |v|. Further outside the board, the surface stays constant; a polynomial would grow there."""


def prior_sigma_mm(coefficients_mm: Floats, sigma_mm: Floats) -> Floats:
    """Return the standard deviations (f,) of the prior at given coefficients (f,) of the surface.

    The prior of tilt and of bow has heavy tails, Student's t distribution: most boards lie well, and those
    that do not may lie in any way. A normal distribution of these standard deviations has the same gradient. They are
    `sigma_mm` (f,) at 0, and grow where links and fiducials contradict that.
    """
    out = sigma_mm.copy()
    for kind in _KINDS:
        far = coefficients_mm[kind] / sigma_mm[kind]
        out[kind] *= np.sqrt(1 + float(far @ far) / (_FREEDOM + len(far)))
    return out


def basis(board_type: BoardType, cad: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions 1, u, v, u², uv, v² at CAD points (k, 2)."""
    return _basis(np.eye(3), np.ascontiguousarray(cad, dtype=np.float64), *frame_of(board_type))


def basis_at_board(board_type: BoardType, cad_matrix: Floats, board_mm: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions at points (k, 2) of the board in tester coordinates, mm."""
    cad_from_board = np.ascontiguousarray(np.linalg.inv(cad_matrix), dtype=np.float64)
    return _basis(cad_from_board, np.ascontiguousarray(board_mm), *frame_of(board_type))


@compiled
def _basis(cad_from_place: Floats, place: Floats, about: Floats, half: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions at points (k, 2) which an affine map (3, 3) transforms to CAD.

    `about` (2,) and `half` (2,) are the centre and the half span of the board, see `frame_of`.
    """
    m, out = cad_from_place, np.empty((len(place), 6))
    for n in range(len(place)):
        x, y = place[n, 0], place[n, 1]
        u = min(max((m[0, 0] * x + m[0, 1] * y + m[0, 2] - about[0]) / half[0], -_EDGE), _EDGE)
        v = min(max((m[1, 0] * x + m[1, 1] * y + m[1, 2] - about[1]) / half[1], -_EDGE), _EDGE)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4], out[n, 5] = 1.0, u, v, u * u, u * v, v * v
    return out


def frame_of(board_type: BoardType) -> tuple[Floats, Floats]:
    """Return the centre (2,) and the half span (2,) of a board type, in CAD units.

    At the centre u and v are 0; at a distance of half the span they are 1 or −1.
    """
    low, high = board_type.extent()
    return (low + high) / 2, np.maximum((high - low) / 2, 1e-9)


def to_surface(board_type: BoardType, coefficients_mm: Floats) -> Surface:
    """Convert the coefficients (6,) of the surface to the `Surface` of a result."""
    about, half = frame_of(board_type)
    c = [round(float(v), 5) for v in coefficients_mm]
    return Surface(
        lift_mm=c[0],
        tilt_mm=(c[1], c[2]),
        bow_mm=(c[3], c[4], c[5]),
        about=(float(about[0]), float(about[1])),
        half_span=(float(half[0]), float(half[1])),
    )
