"""Build the REST response models for the views of a component."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from vaoi_station.api.rest_models import ViewEntry
from vaoi_station.model import FrameRecord

if TYPE_CHECKING:
    from vaoi_station.rendering import View

DEFAULT_COVERAGE = 0.5


Covariance = tuple[tuple[float, float], tuple[float, float]]


def covariances(quality: dict[str, Any], address: str) -> dict[tuple[int, int], Covariance]:
    """Return the covariance (px²) of a component's centre in each frame (camera, row), from a result's `quality`."""
    views = quality.get("component_covariance_px2", {}).get(address, [])
    return {(camera, row): ((xx, xy), (xy, yy)) for camera, row, xx, xy, yy in views}


def view_entry(k: int, view: View, frame: FrameRecord, url: str, covariance: Covariance | None) -> ViewEntry:
    """Build the response model for view k.

    `covariance` is that of the component's centre. `url` is the address of the image.
    """
    return ViewEntry(
        k=k,
        camera=view.camera,
        row=view.row,
        coverage=view.coverage,
        off_center=view.off_center,
        width_px=view.width,
        height_px=view.height,
        px_per_mm=view.px_per_mm,
        covariance_px2=covariance,
        exposure_us=frame.exposure_us,
        gain=frame.gain,
        light=frame.light or None,
        crop_from_cad=view.crop_from_cad.matrix.tolist(),
        cad_from_crop=view.cad_from_crop.matrix.tolist(),
        image_from_crop=view.image_from_crop.matrix.tolist(),
        distorted=view.distorted,
        url=url,
    )


def picture_query(px_per_mm: float | None, min_coverage: float) -> str:
    """Return the query parameters for the address of an image.

    They are those of the list of views to which the image's index k refers.
    """
    # Default values are omitted: one image then has one address, which caches can use.
    asked = {"px_per_mm": px_per_mm} if px_per_mm is not None else {}
    if min_coverage != DEFAULT_COVERAGE:
        asked["min_coverage"] = min_coverage
    return "?" + urlencode(asked) if asked else ""
