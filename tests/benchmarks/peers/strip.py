"""A strip, the input of all stitchers: flattened 8-bit grey frames with their nominal positions.

This module needs only numpy, because it runs in the environment of each peer. The truth is in a separate file, which
only the scorer opens.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

STRIPS = ("plain", "yaw", "parts", "line")
"""Variants, in the order of the table; `render_strips.VARIANTS` defines them."""

Floats = NDArray[np.float64]
Matrices = list[Floats | None]
"""One (3, 3) mosaic_from_frame per frame of the strip; None for a frame that was not placed."""


@dataclass(frozen=True, eq=False)
class Strip:
    """Frames of n cameras and m rows, row by row.

    Attributes:
        name: name of the variant.
        frames: (n·m, h, w) uint8, flattened: undistorted, upright, one scale for all.
        cells: (n·m, 2) camera and row of every frame.
        nominal_px: (n·m, 2) x and y of the first pixel of each frame on the mosaic, from the mechanics alone.
    """

    name: str
    frames: NDArray[np.uint8]
    cells: NDArray[np.int64]
    nominal_px: Floats

    def write(self, directory: Path) -> None:
        """Write the strip into a directory, which is created."""
        directory.mkdir(parents=True, exist_ok=True)
        np.save(directory / "frames.npy", self.frames)
        layout = {"name": self.name, "cells": self.cells.tolist(), "nominal_px": self.nominal_px.tolist()}
        (directory / "strip.json").write_text(json.dumps(layout))

    @classmethod
    def read(cls, directory: Path) -> Strip:
        """Read the strip of a directory."""
        layout = json.loads((directory / "strip.json").read_text())
        cells, nominal_px = np.array(layout["cells"], np.int64), np.array(layout["nominal_px"], np.float64)
        return cls(layout["name"], np.load(directory / "frames.npy"), cells, nominal_px)


def translations(places_px: Floats) -> Matrices:
    """Return matrices of pure shifts from x and y (k, 2) of the first pixels; NaN means not placed."""
    return [_translation(x, y) if np.isfinite(x + y) else None for x, y in places_px]


def _translation(x: float, y: float) -> Floats:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
