"""What a module of `adapters/` offers, and the settings a stitcher is tried with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from .strip import Matrices, Strip


@dataclass(frozen=True)
class Setting:
    """One way to call a stitcher.

    Attributes:
        options: keyword arguments of `place`.
        strips: the strips it is tried on; all if empty.
        as_it_is: whether the stitcher did it all by itself, so that the setting may stand for it in the table.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    strips: tuple[str, ...] = ()
    as_it_is: bool = True


class Adapter(Protocol):
    """One stitcher."""

    @property
    def PACKAGES(self) -> tuple[str, ...]:  # noqa: N802 - a constant of the module
        """Whose versions matter."""

    @property
    def SETTINGS(self) -> dict[str, Setting]:  # noqa: N802 - a constant of the module
        """By the name they have in the table."""

    @property
    def prepare(self) -> Callable[[Strip, Path], Any]:
        """Not timed: from the strip, and the directory it lies in, to what the stitcher takes."""

    @property
    def place(self) -> Callable[..., Matrices]:
        """Timed: one matrix mosaic_from_frame per frame."""
