"""m2stitch: the algorithm of MIST; places are whole pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import m2stitch
import numpy as np
from numpy.typing import NDArray

from ..adapter import Setting
from ..strip import Floats, Matrices, Strip, translations

PACKAGES = ("m2stitch", "numpy", "scipy", "scikit-learn")
SETTINGS = {"default": Setting(), "overlap_diff_threshold=2": Setting({"overlap_diff_threshold": 2}, ("plain", "yaw"))}

Prepared = tuple[NDArray[np.float32], NDArray[np.int64], Floats]


def prepare(strip: Strip, directory: Path) -> Prepared:
    """A stack of zero mean: its phase correlation is not windowed and sees a bright border otherwise."""
    stack = strip.frames.astype(np.float32)
    rows = strip.cells[:, 1].max() - strip.cells[:, 1]  # of its grid, which runs down the mosaic; ours moves up
    return stack - stack.mean(), np.column_stack([rows, strip.cells[:, 0]]), strip.nominal_px[:, ::-1]


def place(prepared: Prepared, **options: Any) -> Matrices:
    """Places of all frames from the grid and the nominal places, both as (y, x)."""
    stack, indices, guess = prepared
    grid, _ = m2stitch.stitch_images(
        stack, position_indices=indices, position_initial_guess=guess, row_col_transpose=False, **options
    )
    return translations(grid.sort_index()[["x_pos", "y_pos"]].to_numpy(np.float64))
