"""Sizes of component pictures and their transforms from CAD, independent of any frame.

A pixel is an area. The edges of a component's bounding box are the outer edges of the border pixels of its picture, so
the centre of pixel (0, 0) lies half a pixel inside the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component

MOST_PIXELS = 16_000_000
"""Largest number of pixels of a temporary image. A caller who exceeds it must ask for fewer pixels per mm."""
_FITTING = 0.999
"""Share of the largest resolution that is used, because the sides of a picture are rounded to whole pixels."""


@dataclass(frozen=True, eq=False)
class Crops:
    """The sizes of k component pictures, and their transforms from CAD coordinates and back."""

    size: Floats
    """(k, 2) width and height of each picture in px, whole numbers."""
    crop_from_cad: Floats
    """(k, 3, 3) matrices from CAD coordinates to the pixels of each picture; scale and shift only."""
    cad_from_crop: Floats
    """(k, 3, 3) inverse matrices, from pixels to CAD coordinates."""


def fitting_resolutions(components: Sequence[Component], board_type: BoardType, px_per_mm: float) -> Floats:
    """Return the resolutions (k,) in px/mm of k pictures: `px_per_mm`, or less where a picture would be too large."""
    area = np.prod(2 * _reach(components) * board_type.mm_per_unit, axis=-1)
    return np.asarray(np.minimum(px_per_mm, _FITTING * np.sqrt(MOST_PIXELS / area)), dtype=np.float64)


def compute_crops(components: Sequence[Component], board_type: BoardType, px_per_mm: float | Floats) -> Crops:
    """Compute the size and the transform of each component's picture, which shows the component upright.

    `px_per_mm` is one resolution for all pictures, or one for each. CAD "up" points up in the picture. The board's side
    is shown as the cameras see it, never mirrored.

    Raises:
        InputError: a picture would have more than `MOST_PIXELS`.
    """
    center = np.array([c.center for c in components], dtype=np.float64)
    reach = _reach(components)
    resolution = np.broadcast_to(np.asarray(px_per_mm, dtype=np.float64), (len(components),))
    size = np.maximum(np.round(2 * reach * resolution[:, None] * board_type.mm_per_unit), 1)
    for component, (width, height), wanted in zip(components, size, resolution.tolist(), strict=True):
        if width * height > MOST_PIXELS:
            limit = f"small enough for {MOST_PIXELS / 1e6:.0f} megapixels (this would be {width:.0f}×{height:.0f})"
            raise InputError.field(component.address, "px_per_mm", wanted, limit)
    # Pictures show the board as the camera sees it, never mirrored (docs/conventions.md). On the bottom side, CAD x
    # runs to the left.
    way = np.array([1.0 if board_type.side == "top" else -1.0, 1.0 if board_type.y_axis == "down" else -1.0])
    # The scale uses the rounded size, so that the box fills the picture exactly. The sides change by less than a pixel.
    scale = way * size / (2 * reach)
    origin = center - way * reach
    there, back = np.zeros((len(components), 3, 3)), np.zeros((len(components), 3, 3))
    for axis in (0, 1):
        there[:, axis, axis], there[:, axis, 2] = scale[:, axis], -scale[:, axis] * origin[:, axis] - 0.5
        back[:, axis, axis], back[:, axis, 2] = 1 / scale[:, axis], origin[:, axis] + 0.5 / scale[:, axis]
    there[:, 2, 2] = back[:, 2, 2] = 1
    return Crops(size, there, back)


def _reach(components: Sequence[Component]) -> Floats:
    """Return half of the width and height (k, 2) of the bounding boxes of k components, in CAD units."""
    half = np.array([(c.width, c.height) for c in components]) / 2
    angle = np.radians([c.rotation for c in components])
    c, s = np.abs(np.cos(angle)), np.abs(np.sin(angle))
    return np.stack([c * half[:, 0] + s * half[:, 1], s * half[:, 0] + c * half[:, 1]], -1)
