"""m2stitch: the algorithm of MIST; positions are whole pixels."""

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
    """Return frames of zero mean, grid indices and nominal positions (y, x)."""
    # Its phase correlation has no window, so a mean above zero acts as a bright border.
    stack = strip.frames.astype(np.float32)
    # Rows of its grid run down the mosaic; ours run up.
    rows = strip.cells[:, 1].max() - strip.cells[:, 1]
    return stack - stack.mean(), np.column_stack([rows, strip.cells[:, 0]]), strip.nominal_px[:, ::-1]


def place(prepared: Prepared, **options: Any) -> Matrices:
    """Return positions of all frames, from the grid and the nominal positions."""
    stack, indices, guess = prepared
    grid, _ = m2stitch.stitch_images(
        stack, position_indices=indices, position_initial_guess=guess, row_col_transpose=False, **options
    )
    return translations(grid.sort_index()[["x_pos", "y_pos"]].to_numpy(np.float64))
