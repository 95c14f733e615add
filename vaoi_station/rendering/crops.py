"""Sizes of component pictures and their transforms from CAD, independent of any frame.

A pixel is an area. The edges of a component's bounding box are the outer edges of the border pixels of its picture, so
the centre of pixel (0, 0) lies half a pixel inside the box. With a margin, the box is larger on all sides. A picture
that is turned to the component's own orientation shows its footprint, and not the bounding box in CAD.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering.framing import Framing

MOST_PIXELS = 16_000_000
"""Largest number of pixels of a temporary image. A caller who exceeds it must ask for fewer pixels per mm."""
_FITTING = 0.999
"""Share of the largest resolution that is used, because the sides of a picture are rounded to whole pixels."""
_UNFRAMED = Framing()


class Footprints(NamedTuple):
    """The footprints of k components as arrays, in CAD units."""

    components: Sequence[Component]
    board_type: BoardType
    center: Floats
    """(k, 2) centres."""
    half: Floats
    """(k, 2) half the width and half the height before rotation."""
    along: Floats
    """(k, 2, 2) half the width (`[:, :, 0]`) and half the height (`[:, :, 1]`) as vectors in CAD."""
    box: Floats
    """(k, 2) half of the width and height of the bounding boxes."""

    @staticmethod
    def of(components: Sequence[Component], board_type: BoardType) -> Footprints:
        """Collect the footprints of components of a board type."""
        # Imported on first use, because Numba takes a moment to load.
        from vaoi_station.rendering.frame_pairs import turn_boxes

        rows = [(*c.center, c.width, c.height, c.rotation) for c in components]
        # Rotations count counter-clockwise as seen on the top of the board, wherever the y axis points.
        way = 1.0 if board_type.y_axis == "up" else -1.0
        boxes = turn_boxes(np.array(rows, dtype=np.float64).reshape(-1, 5), way)
        return Footprints(components, board_type, *boxes)

    def fitting(self, px_per_mm: float) -> Floats:
        """Return the resolutions (k,) of k pictures, px/mm: `px_per_mm`, or less where a picture would be too large."""
        sides_mm = 2 * self.box * self.board_type.mm_per_unit
        most = _FITTING * np.sqrt(MOST_PIXELS / (sides_mm[:, 0] * sides_mm[:, 1]))
        return np.asarray(np.minimum(px_per_mm, most), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Crops:
    """The sizes of k component pictures, and their transforms from CAD coordinates and back."""

    size: Floats
    """(k, 2) width and height of each picture in px, whole numbers."""
    crop_from_cad: Floats
    """(k, 3, 3) matrices from CAD coordinates to the pixels of each picture: scale and shift, and a turn if the
    pictures are turned to the components' own orientation."""
    cad_from_crop: Floats
    """(k, 3, 3) inverse matrices, from pixels to CAD coordinates."""
    bare: NDArray[np.bool_]
    """(k,) whether a picture shows the footprint and nothing else."""
    px_per_mm: Floats
    """(k,) resolution of each picture."""
    footprints: Footprints


def compute_crops(footprints: Footprints, px_per_mm: float | Floats, framing: Framing = _UNFRAMED) -> Crops:
    """Compute the size and the transform of each component's picture, which shows the component upright.

    `px_per_mm` is one resolution for all pictures, or one for each. CAD "up" points up in the picture, or what the CAD
    library draws as "up". The board's side is shown as the cameras see it, never mirrored.

    Raises:
        InputError: a picture would have more than `MOST_PIXELS`.
    """
    from vaoi_station.rendering.frame_pairs import upright

    components, board_type, center, half, along, box = footprints
    turned, mm, count = framing.align == "part", board_type.mm_per_unit, len(components)
    half = half if turned else box
    resolution = np.full(count, px_per_mm, dtype=np.float64)
    reach = half + framing.margin_mm / mm
    size = np.maximum(np.rint(2 * reach * resolution[:, None] * mm), 1)
    for k in np.flatnonzero(size[:, 0] * size[:, 1] > MOST_PIXELS).tolist():
        raise _too_large(components[k], (2 * half[k] * mm).tolist(), float(resolution[k]), framing, size[k].tolist())
    # Pictures show the board as the camera sees it, never mirrored (docs/conventions.md). On the bottom side, CAD x
    # runs to the left.
    way = 1.0 if board_type.side == "top" else -1.0, 1.0 if board_type.y_axis == "down" else -1.0
    matrices = upright(center, half, along, reach, size, way, turned)
    return Crops(size, *matrices, resolution, footprints)


def _too_large(
    component: Component, sides_mm: list[float], px_per_mm: float, framing: Framing, size: list[float]
) -> InputError:
    """Return the refusal of a picture that is too large: its margin or its resolution."""
    (a, b), most = sides_mm, MOST_PIXELS / px_per_mm**2
    what = f"small enough for {MOST_PIXELS / 1e6:.0f} megapixels (this would be {size[0]:.0f}×{size[1]:.0f})"
    if not framing.margin_mm or a * b > most:
        area = (a + 2 * framing.margin_mm) * (b + 2 * framing.margin_mm)
        limit = f"at most {_floored(_FITTING * math.sqrt(MOST_PIXELS / area))}, {what}"
        return InputError.field(component.address, "px_per_mm", px_per_mm, limit)
    # The margin m at which (a + 2 m)(b + 2 m) is as large as a picture may be.
    margin = (math.sqrt((a - b) ** 2 + 4 * most) - (a + b)) / 4
    limit = f"at most {_floored(margin)} at {px_per_mm:g} px/mm, {what}"
    return InputError.field(component.address, "margin_mm", framing.margin_mm, limit)


def _floored(limit: float) -> str:
    """Return a limit with two decimals that is not above it."""
    return f"{math.floor(100 * limit) / 100:g}"
