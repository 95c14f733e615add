"""One view of a component, in JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import urlencode

from vaoi_station.api.shapes import ViewEntry

if TYPE_CHECKING:
    from vaoi_station.rendering.temporary import View


def view_entry(k: int, view: View, run_url: str, ref: str, query: str) -> ViewEntry:
    """View k with the addresses of its image and its frame."""
    height, width = view.shape
    return ViewEntry(
        k=k,
        camera=view.camera,
        row=view.row,
        coverage=view.coverage,
        width_px=width,
        height_px=height,
        px_per_mm=view.px_per_mm,
        exposure_us=view.exposure_us,
        light=view.light or None,
        crop_from_cad=view.crop_from_cad.matrix.tolist(),
        cad_from_crop=view.crop_from_cad.inverse().matrix.tolist(),
        image_from_crop=view.image_from_crop.matrix.tolist(),
        url=f"{run_url}/components/{ref}/images/{k}{query}",
        frame_url=f"{run_url}/frames/{view.camera}/{view.row}",
    )


def picture_query(px_per_mm: float | None, min_coverage: float) -> str:
    """The query that makes an image's address mean the same view as the list it came from."""
    asked = {"px_per_mm": px_per_mm} if px_per_mm is not None else {}
    if min_coverage != 0.5:
        asked["min_coverage"] = min_coverage
    return "?" + urlencode(asked) if asked else ""
