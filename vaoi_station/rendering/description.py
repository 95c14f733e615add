"""What is known about one temporary image, by the names that REST and the files of `vaoi cut` use."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch
from vaoi_station.rendering.measures import Measures
from vaoi_station.rendering.selection import ChosenView
from vaoi_station.rendering.view import sigma_px


def component_covariances(result: Stitch, ref: str) -> dict[tuple[int, int], Floats]:
    """Return the covariance (2, 2) in px² of a component's centre in each frame, by (camera, row)."""
    try:
        rows = result.quality.get("component_covariance_px2", {}).get(ref, [])
        return {(int(c), int(j)): np.array([[xx, xy], [xy, yy]], dtype=np.float64) for c, j, xx, xy, yy in rows}
    except (AttributeError, TypeError, ValueError) as error:
        # `quality` accepts any keys and values, so that readers of older versions can open newer results.
        raise InputError(
            f"the result: quality.component_covariance_px2 of {ref!r} is not a list of [camera, row, xx, xy, yy].",
            action="Stitch the recording again.",
        ) from error


def describe(choice: ChosenView, covariance_px2: Floats | None) -> dict[str, Any]:
    """Return the figures and matrices of one temporary image; docs/rest.md defines each.

    `covariance_px2` (2, 2) is that of the component's place in the frame, px²; None if it is not known. Figures that
    are not known are None.
    """
    view, facts, measures = choice.view, choice.facts, choice.measures or Measures(None, None)
    sigma = sigma_px(covariance_px2)
    return {
        "camera": view.camera,
        "row": view.row,
        "coverage": view.coverage,
        "off_center": view.off_center,
        "width_px": view.width,
        "height_px": view.height,
        "px_per_mm": view.px_per_mm,
        "covariance_px2": None if covariance_px2 is None else covariance_px2.tolist(),
        "sigma_px": sigma,
        "sigma_mm": None if sigma is None else sigma / view.frame_px_per_mm,
        "view_azimuth_deg": view.azimuth_deg,
        "view_angle_deg": view.angle_deg,
        "sharpness_per_mm": measures.sharpness_per_mm,
        "saturated": measures.saturated,
        "time_s": facts.time_s,
        "exposure_us": facts.exposure_us,
        "gain": facts.gain,
        "light": facts.light,
        "crop_from_cad": view.crop_from_cad.matrix.tolist(),
        "cad_from_crop": view.cad_from_crop.matrix.tolist(),
        "image_from_crop": view.image_from_crop.matrix.tolist(),
        "plane": view.plane,
        "height_mm": view.height_mm,
        "minus": None if choice.minus is None else (choice.minus.view.camera, choice.minus.view.row),
        "distorted": view.distorted,
    }
