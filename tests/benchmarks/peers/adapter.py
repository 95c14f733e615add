"""The interface of the modules in `adapters/`, and the settings with which a stitcher is run."""

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
        strips: the strips it runs on; all if empty.
        as_it_is: whether the stitcher ran without our help, so that the setting may represent it in the table.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    strips: tuple[str, ...] = ()
    as_it_is: bool = True


class Adapter(Protocol):
    """One stitcher."""

    @property
    def PACKAGES(self) -> tuple[str, ...]:  # noqa: N802 - a constant of the module
        """Packages whose versions are recorded."""

    @property
    def SETTINGS(self) -> dict[str, Setting]:  # noqa: N802 - a constant of the module
        """Settings by their name in the table."""

    @property
    def prepare(self) -> Callable[[Strip, Path], Any]:
        """Conversion of a strip and its directory to the input of the stitcher; not timed."""

    @property
    def place(self) -> Callable[..., Matrices]:
        """Placement, timed: returns one matrix mosaic_from_frame per frame."""
