"""Base classes and field types of all data models. The models are immutable and do not convert strings to numbers."""

from __future__ import annotations

from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

MOST_MM = 10_000.0
"""Largest coordinate or length in a document, mm. No board, line or camera array is longer."""
MOST_ENTRY = 1e9
"""Largest absolute entry of a matrix; the largest entry must be at least the inverse of this. Real entries are below
10⁶."""


class Strict(BaseModel):
    """Base class of immutable models that refuse unknown keys."""

    # By default, pydantic keeps up to 16,384 texts that it has read from JSON, such as ids and times.
    model_config = ConfigDict(frozen=True, extra="forbid", cache_strings="keys")


class FrozenModel(BaseModel):
    """Base class of immutable models that accept the user's `x_…` keys and refuse all other unknown keys."""

    model_config = ConfigDict(frozen=True, extra="allow", arbitrary_types_allowed=True, cache_strings="keys")

    # Pydantic has no pattern for extra keys: it accepts all of them, and this validator refuses the others.
    @model_validator(mode="after")
    def _only_known_keys(self) -> Self:
        unknown = [k for k in self.model_extra or {} if not k.startswith("x_")]
        if unknown:
            raise ValueError(f"unknown key(s) {', '.join(map(repr, unknown))}; own keys must begin with 'x_'")
        return self


def parse_square(value: Any, size: int) -> NDArray[np.float64]:
    """Convert nested lists to a finite (size, size) matrix; raise ValueError for anything else."""
    shape = f"{size}×{size}"
    try:
        m = np.array(value)
    except ValueError as error:
        raise ValueError(f"has rows of different lengths, must be {shape}") from error
    except OverflowError as error:  # an integer that no float can hold
        raise ValueError(f"has an entry beyond the limit of ±{MOST_ENTRY:g}") from error
    # NumPy would convert strings and booleans; only numbers written as numbers are accepted. Among numbers, it converts
    # a boolean to 1.0, so the entries are checked as well.
    if m.dtype.kind not in "iuf" or (not isinstance(value, np.ndarray) and _has_boolean(value)):
        raise ValueError(f"is not a matrix of numbers, must be {shape} numbers")
    m = m.astype(np.float64)
    if m.shape != (size, size):
        raise ValueError(f"has shape {m.shape}, must be {shape}")
    if not np.isfinite(m).all():
        raise ValueError("has NaN or infinite entries, all must be finite")
    return m


def _parse_matrix(value: Any) -> NDArray[np.float64]:
    """Convert nested lists to a read-only, finite, invertible (3, 3) matrix."""
    m = parse_square(value, 3)
    largest = np.abs(m).max()
    if largest > MOST_ENTRY or 0 < largest < 1 / MOST_ENTRY:
        raise ValueError(
            f"has a largest entry of {largest:g} (absolute), must be between {1 / MOST_ENTRY:g} and {MOST_ENTRY:g}"
        )
    if _is_singular(m):
        raise ValueError("is singular, must be invertible")
    m.setflags(write=False)
    return m


def _has_boolean(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_has_boolean, value))
    return isinstance(value, bool | np.bool_)


def _is_singular(m: NDArray[np.float64]) -> bool:
    """Return whether a matrix has no inverse, apart from rounding errors."""
    # Entries have the units px, mm and 1/mm, so rows and columns are scaled to 1 before the determinant is compared.
    for axis in (1, 0):
        size = np.abs(m).max(axis=axis, keepdims=True)
        if not size.all():
            return True
        m = m / size
    return bool(abs(np.linalg.det(m)) < 1e-12)


Matrix = Annotated[NDArray[np.float64], BeforeValidator(_parse_matrix), PlainSerializer(lambda m: m.tolist())]
"""A finite, invertible 3×3 matrix. Files contain it as nested lists, row by row."""

Finite = Annotated[float, Field(strict=True, ge=-1e12, le=1e12, allow_inf_nan=False)]
"""A number. Squares and products of such numbers cannot overflow."""
Positive = Annotated[float, Field(strict=True, gt=0, le=1e12, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True, ge=-(2**63), lt=2**63)]
"""An integer of 64 bits. Like `Finite` and `Positive`, it refuses strings and booleans."""
Millimetres = Annotated[float, Field(strict=True, ge=-MOST_MM, le=MOST_MM, allow_inf_nan=False)]
Pixels = Annotated[float, Field(strict=True, ge=-1e6, le=1e6, allow_inf_nan=False)]
Point = tuple[Finite, Finite]
PointMm = tuple[Millimetres, Millimetres]
PointPx = tuple[Pixels, Pixels]
