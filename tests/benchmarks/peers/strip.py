"""A strip as every stitcher gets it: flattened 8-bit grey frames, and where the mechanics would have put them.

Only numpy is needed here: this module runs in the environment of every peer. The truth lies in a
file of its own, which the scorer alone opens.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

STRIPS = ("plain", "yaw", "parts", "line")
"""Variants, in the order of the table; `film.VARIANTS` says what they are."""

Floats = NDArray[np.float64]
Matrices = list[Floats | None]
"""One 3×3 mosaic_from_frame per frame of the strip, in its order; None where a frame could not be placed."""


@dataclass(frozen=True, eq=False)
class Strip:
    """Frames of n cameras and m rows, row by row.

    Attributes:
        name: of the variant.
        frames: (n·m, h, w) uint8, flattened: undistorted, upright, one scale for all.
        cells: (n·m, 2) camera and row of every frame.
        nominal_px: (n·m, 2) x and y of the first pixel of every frame on the mosaic, by the mechanics alone.
    """

    name: str
    frames: NDArray[np.uint8]
    cells: NDArray[np.int64]
    nominal_px: Floats

    def write(self, directory: Path) -> None:
        """Write the strip into a directory, which is made."""
        directory.mkdir(parents=True, exist_ok=True)
        np.save(directory / "frames.npy", self.frames)
        layout = {"name": self.name, "cells": self.cells.tolist(), "nominal_px": self.nominal_px.tolist()}
        (directory / "strip.json").write_text(json.dumps(layout))

    @classmethod
    def read(cls, directory: Path) -> Strip:
        """The strip of a directory."""
        layout = json.loads((directory / "strip.json").read_text())
        cells, nominal_px = np.array(layout["cells"], np.int64), np.array(layout["nominal_px"], np.float64)
        return cls(layout["name"], np.load(directory / "frames.npy"), cells, nominal_px)


def translations(places_px: Floats) -> Matrices:
    """Matrices of frames that were only shifted, from x and y (k, 2) of their first pixels; NaN: not placed."""
    return [_translation(x, y) if np.isfinite(x + y) else None for x, y in places_px]


def _translation(x: float, y: float) -> Floats:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
