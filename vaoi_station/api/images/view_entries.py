"""Build the REST response models for the images of a component."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlencode

from vaoi_station.api.rest_models import ViewEntry
from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.description import describe
from vaoi_station.rendering.request import ImageRequest
from vaoi_station.rendering.selection import ChosenView

Covariance = tuple[tuple[float, float], tuple[float, float]]


def covariances(quality: dict[str, Any], address: str) -> dict[tuple[int, int], Covariance]:
    """Return the covariance (px²) of a component's centre in each frame (camera, row), from a result's `quality`."""
    views = quality.get("component_covariance_px2", {}).get(address, [])
    return {(camera, row): ((xx, xy), (xy, yy)) for camera, row, xx, xy, yy in views}


def view_entry(k: int, choice: ChosenView, url: str, covariance_px2: Floats | None) -> ViewEntry:
    """Build the response model for image k.

    `covariance_px2` is that of the component's place in the frame. `url` is the address of the image.
    """
    return ViewEntry(k=k, url=url, **describe(choice, covariance_px2))


def picture_query(wanted: ImageRequest) -> str:
    """Return the query parameters for the address of an image.

    They are those of the list of images to which the image's index k refers.
    """
    # Default values are omitted: one image then has one address, which caches can use.
    asked = wanted.unmeasured().options()
    return "?" + urlencode(asked) if asked else ""
