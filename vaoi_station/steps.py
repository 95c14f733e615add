"""Computations of seconds as steps of milliseconds, so that urgent work can come in between."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Steps: TypeAlias = Generator[None, None, T]
"""A computation that yields after each step, and returns its result at the end."""


def completed(steps: Steps[T]) -> T:
    """Perform all steps of a computation at once, and return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
