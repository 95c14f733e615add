"""multiview-stitcher (the method of BigStitcher in Python): pairwise overlaps, then least squares over all pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dask
import numpy as np
from multiview_stitcher import msi_utils, registration
from multiview_stitcher import spatial_image_utils as si_utils

from ..adapter import Setting
from ..strip import Floats, Matrices, Strip

PACKAGES = ("multiview-stitcher", "antspyx", "numpy", "scikit-image", "dask")
_STAGE = "stage"
_FINE = {"pairwise_reg_func_kwargs": {"upsample_factor": 100}}
_RIGID = {
    "pairwise_reg_func": registration.registration_ANTsPy,
    "pairwise_reg_func_kwargs": {"transform_types": ["Rigid"]},
    "groupwise_resolution_kwargs": {"transform": "rigid"},
    "pre_registration_pruning_method": "keep_axis_aligned",
}
SETTINGS = {
    "keep_axis_aligned, upsample_factor=100": Setting(
        {"pre_registration_pruning_method": "keep_axis_aligned", **_FINE}
    ),
    "default": Setting(),
    "ANTsPy, rigid, keep_axis_aligned": Setting(_RIGID, ("yaw",)),
}
"""Pairs with a relative rotation need a registration other than the default; it takes many minutes."""


def prepare(strip: Strip, directory: Path) -> tuple[list[Any], Floats]:
    """Return views at their nominal positions, in pixels."""
    views = []
    for frame, (x, y) in zip(strip.frames, strip.nominal_px, strict=True):
        place = {"y": float(y), "x": float(x)}
        sim = si_utils.get_sim_from_array(frame, ["y", "x"], {"y": 1.0, "x": 1.0}, place, transform_key=_STAGE)
        views.append(msi_utils.get_msim_from_sim(sim, scale_factors=[]))
    return views, strip.nominal_px


def place(prepared: tuple[list[Any], Floats], **options: Any) -> Matrices:
    """Return transforms of all views, from pixels."""
    views, nominal_px = prepared
    with dask.config.set(scheduler="single-threaded"):
        found = registration.register(views, transform_key=_STAGE, reg_channel_index=0, **options)
    return [_from_pixels(m, start) for m, start in zip(found, nominal_px, strict=True)]


def _from_pixels(transform: Any, start_px: Floats) -> Floats:
    """Convert its matrix, (y, x) at nominal positions to (y, x), into ours, (x, y) of pixels to (x, y)."""
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])
    shift = np.eye(3)
    shift[:2, 2] = start_px
    return np.asarray(swap @ np.asarray(transform, np.float64).reshape(-1, 3, 3)[0] @ swap @ shift)
