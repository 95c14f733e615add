"""Transforms of the plane that carry their source and target coordinate systems; section 3.1 of the paper.

A transform is named `target_from_source`. A product is valid only if the inner systems are equal, as in
`image_from_tester @ tester_from_cad`. Matrices are 3×3, act on homogeneous column vectors and are read-only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vaoi_station.errors import InternalError

Floats = NDArray[np.float64]
_KIND_TOLERANCE = 1e-6
"""Largest accepted relative deviation of a matrix from a similarity or rigid motion: rounding errors only."""


class System(StrEnum):
    """A coordinate system; docs/conventions.md shows all of them."""

    CAD = "cad"  # coordinates of the CAD data, in the unit of the board type
    TESTER = "tester"  # mm in the conveyor's plane, fixed to the board. In row 0 they are equal to ROW coordinates
    ROW = "row"
    """mm in the conveyor's plane, fixed to the cameras. The board moves in these coordinates from row to row."""
    IMAGE = "image"  # undistorted pixels of one frame; the centre of the top-left pixel is (0, 0)
    CROP = "crop"  # pixels of a temporary image. The centre of the top-left pixel is (0, 0), as in IMAGE


def apply(matrix: ArrayLike, points: ArrayLike) -> Floats:
    """Map points with a homogeneous matrix.

    Args:
        matrix: (3, 3), source to target.
        points: (..., 2) in the source system.

    Returns:
        (..., 2) in the target system.
    """
    m = np.asarray(matrix, dtype=np.float64)
    p = np.asarray(points, dtype=np.float64)
    q = p @ m[:, :2].T + m[:, 2]
    return np.asarray(q[..., :2] / q[..., 2:], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Projective:
    """A homography (8 parameters), such as N_i and M_ij."""

    matrix: Floats
    target: System
    source: System

    def __post_init__(self) -> None:
        # A copy, so that the caller's array stays writeable and later changes of it have no effect here.
        m = np.array(self.matrix, dtype=np.float64, order="C")
        if m.shape != (3, 3) or not np.isfinite(m).all():
            raise InternalError(f"{self.target}_from_{self.source} is not a finite 3×3 matrix: {m!r}")
        m.setflags(write=False)
        object.__setattr__(self, "matrix", m)

    def __reduce__(self) -> tuple[type[Projective], tuple[Floats, System, System]]:
        """Pickle the arguments, so that the matrix is read-only in the other process too.

        Numba compiles a separate version of a function for writeable arrays.
        """
        return type(self), (self.matrix, self.target, self.source)

    def __matmul__(self, other: Projective) -> Projective:
        if self.source is not other.target:
            raise InternalError(f"{self.target}_from_{self.source} @ {other.target}_from_{other.source}: no match")
        kind = _more_general(type(self), type(other))
        return kind(np.asarray(self.matrix @ other.matrix, np.float64), self.target, other.source)

    def inverse(self) -> Self:
        """Return the inverse transform. It has the same class as this transform."""
        try:
            inverted = np.asarray(np.linalg.inv(self.matrix), np.float64)
        except np.linalg.LinAlgError as error:
            raise InternalError(f"{self.target}_from_{self.source} is singular: {self.matrix.tolist()}") from error
        return type(self)(inverted, self.source, self.target)

    def __call__(self, points: ArrayLike) -> Floats:
        """Map points (..., 2) from the source system to the target system."""
        return apply(self.matrix, points)

    def scale_at(self, point: ArrayLike) -> float:
        """Return the local scale at a source point, in target units per source unit (square root of the area ratio)."""
        p = np.asarray(point, dtype=np.float64)
        w = float(self.matrix[2, :2] @ p + self.matrix[2, 2])
        return math.sqrt(abs(float(np.linalg.det(self.matrix)) / w**3))

    def scale_onto(self, point: tuple[float, float]) -> float:
        """Return the local scale at the source of a target point, in target units per source unit."""
        # Plain numbers: numpy takes ten times as long for one point, and this is part of the time of a picture.
        (a, b, c), (d, e, f), (g, h, i) = self.matrix.tolist()
        x, y = point
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        # The third row of the inverse gives the inverse of the denominator at the source.
        inverse_w = ((d * h - e * g) * x + (b * g - a * h) * y + a * e - b * d) / determinant
        return math.sqrt(abs(determinant * inverse_w**3))

    @property
    def mirrors(self) -> bool:
        """Whether the transform changes handedness."""
        return bool(np.sign(np.linalg.det(self.matrix)) * np.sign(self.matrix[2, 2]) < 0)


class Similarity(Projective):
    """A rotation, translation, scale and optional reflection, such as C (equation 9)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        (a, b), (c, d) = self.matrix[:2, :2]
        # Both columns must have the same length and be orthogonal; all three terms scale with the area.
        area = abs(a * d - b * c)
        skew = max(abs(a * a + c * c - area), abs(b * b + d * d - area), abs(a * b + c * d))
        if np.abs(self.matrix[2] - (0, 0, 1)).max() > _KIND_TOLERANCE or area == 0 or skew > _KIND_TOLERANCE * area:
            raise InternalError(f"{self.target}_from_{self.source} is no similarity: {self.matrix.tolist()}")

    @property
    def scale(self) -> float:
        """Scale of the similarity: target units per source unit."""
        return math.sqrt(abs(float(np.linalg.det(self.matrix[:2, :2]))))

    @property
    def angle_rad(self) -> float:
        """Angle of the source's x axis in the target system, from target x towards target y."""
        return math.atan2(self.matrix[1, 0], self.matrix[0, 0])

    @classmethod
    def of(
        cls, scale: float, angle_rad: float, shift: ArrayLike, target: System, source: System, *, mirrored: bool = False
    ) -> Similarity:
        """Create a similarity that flips the source's y axis if `mirrored`, then scales and rotates, then shifts."""
        c, s = scale * math.cos(angle_rad), scale * math.sin(angle_rad)
        f = -1.0 if mirrored else 1.0
        x, y = np.asarray(shift, dtype=np.float64)
        return Similarity(np.array([[c, -s * f, x], [s, c * f, y], [0, 0, 1]]), target, source)


class Euclidean(Similarity):
    """A rigid motion: rotation and translation, such as D_j."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(float(np.linalg.det(self.matrix[:2, :2])) - 1) > _KIND_TOLERANCE:
            raise InternalError(f"{self.target}_from_{self.source} is no rigid motion: {self.matrix.tolist()}")

    @classmethod
    def motion(cls, angle_rad: float, shift_mm: ArrayLike, target: System, source: System) -> Euclidean:
        """Create a rotation by an angle (from x towards y), followed by a shift."""
        return cls(Similarity.of(1.0, angle_rad, shift_mm, target, source).matrix, target, source)

    @classmethod
    def identity(cls, target: System, source: System) -> Euclidean:
        """Create the identity transform between two coordinate systems."""
        return cls(np.eye(3), target, source)


def _more_general(a: type[Any], b: type[Any]) -> type[Projective]:
    """Return the more general of two classes of transform, which is the class of a product of both."""
    for kind in (Projective, Similarity, Euclidean):
        if kind in (a, b):
            return kind
    raise InternalError(f"unknown transforms {a} and {b}")
