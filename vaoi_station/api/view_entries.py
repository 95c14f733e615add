"""One view of a component, in JSON."""

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
    """Of a component's centre in every frame that shows it (camera, row), px², as the result says."""
    views = quality.get("component_covariance_px2", {}).get(address, [])
    return {(camera, row): ((xx, xy), (xy, yy)) for camera, row, xx, xy, yy in views}


def view_entry(k: int, view: View, frame: FrameRecord, url: str, covariance: Covariance | None) -> ViewEntry:
    """View k, the frame it is taken from, how surely it is placed, and the address of its image."""
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
        light=frame.light or None,
        crop_from_cad=view.crop_from_cad.matrix.tolist(),
        cad_from_crop=view.cad_from_crop.matrix.tolist(),
        image_from_crop=view.image_from_crop.matrix.tolist(),
        distorted=view.distorted,
        url=url,
    )


def picture_query(px_per_mm: float | None, min_coverage: float) -> str:
    """The query that makes an image's address mean the same view as the list it came from."""
    asked = {"px_per_mm": px_per_mm} if px_per_mm is not None else {}
    if min_coverage != DEFAULT_COVERAGE:
        asked["min_coverage"] = min_coverage
    return "?" + urlencode(asked) if asked else ""
