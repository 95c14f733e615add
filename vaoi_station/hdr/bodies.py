"""Bodies in the picture of a region: each is merged in the plane of its top, in which it lies still from view to view.

The ground is merged in the plane of the board. Where footprints are, what the plane of the body's top shows takes its
place. Bodies whose height is not known stay on the board, and have ghosts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.hdr.merging import Exposed, MergedPicture, merge_views
from vaoi_station.hdr.parts import LEAST_COVERAGE, REGION
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.rendering import Framing, View, ViewCalculator


class Body(NamedTuple):
    """A body in the picture of a region."""

    part: Component
    """The rectangle of the picture around its footprint, as a region of the board."""
    height_mm: float
    box: tuple[int, int, int, int]
    """First column and row of that rectangle, and those after its last."""
    corners: Floats
    """(4, 2) corners of the footprint in pixels of the picture."""


def bodies_in(view: View, board_type: BoardType, stitch: Stitch) -> list[Body]:
    """Return the bodies of known height in the picture of a region, the highest last: it hides others.

    `view` is any view of the region.
    """
    heights = ((c, known_height_mm(c, board_type, stitch)) for c in board_type.components)
    raised = [(c, height_mm) for c, height_mm in heights if height_mm]
    footprints = stitch.footprints(board_type, [c for c, _ in raised])
    found = []
    for number, ((_, height_mm), footprint) in enumerate(zip(raised, footprints, strict=True)):
        corners = apply(view.crop_matrix, footprint)
        low = np.maximum(np.floor(corners.min(0) + 0.5), 0)
        high = np.minimum(np.ceil(corners.max(0) + 0.5), (view.width, view.height))
        if (high <= low).any():
            continue
        # Half a pixel around the centres of its pixels: the picture of this part lies on the grid of the region.
        ends = apply(view.cad_from_crop.matrix, np.stack([low, high]) - 0.5)
        (x, y), (width, height) = ends.mean(0).tolist(), np.abs(ends[1] - ends[0]).tolist()
        x0, y0, x1, y1 = (int(v) for v in (*low, *high))
        part = Component(ref=f"{REGION} {number}", center=(x, y), width=width, height=height)
        found.append(Body(part, height_mm, (x0, y0, x1, y1), corners))
    return sorted(found, key=lambda body: body.height_mm)


def views_of_bodies(
    calculator: ViewCalculator, bodies: Sequence[Body], px_per_mm: float
) -> list[tuple[Body, tuple[View, ...]]]:
    """Return the views of bodies in the planes of their tops, at the resolution of the region."""
    views = calculator.compute_all(
        [body.part for body in bodies],
        px_per_mm=px_per_mm,
        min_coverage=LEAST_COVERAGE,
        framing=Framing(plane="top"),
        heights_mm={body.part.address: body.height_mm for body in bodies},
    )
    return [(body, views[body.part.address]) for body in bodies]


def merge_region(
    views: Sequence[Exposed],
    bodies: Sequence[tuple[Body, Sequence[Exposed]]],
    *,
    groups: bool = True,
    sigma: bool = True,
) -> list[MergedPicture]:
    """Merge the views of a region as `merge_views` does, with its bodies in the planes of their tops.

    Each picture shows its bodies by the frames of which its ground is merged.
    """
    pictures = merge_views(views, groups=groups, sigma=sigma)
    for picture in pictures:
        frames = {(view.camera, view.row) for view in picture.views}
        for body, exposed in bodies:
            if mine := [e for e in exposed if e.key in frames]:
                _lay(picture, body, merge_views(mine, groups=False, sigma=sigma)[-1])
    return pictures


def _lay(picture: MergedPicture, body: Body, top: MergedPicture) -> None:
    """Replace the pixels of a footprint by those in the plane of the body's top, where it has a value."""
    x0, y0, x1, y1 = body.box
    if top.value.shape != (y1 - y0, x1 - x0):
        return  # a rounding of the sizes to whole pixels went the other way: its grid would be another one
    mask = pixels_inside(body.corners - (x0, y0), x1 - x0, y1 - y0) & np.isfinite(top.value)
    for whole, part in ((picture.value, top.value), (picture.deviation, top.deviation)):
        if whole is not None and part is not None:
            whole[y0:y1, x0:x1][mask] = part[mask]
