"""Motions of the board between two rows that a repeated pattern allows, such as a grid of LEDs.

The coarse search of each camera takes the shift that fits best. Where a pattern repeats itself, others fit nearly as
well, and two cameras may take different ones although they see one motion. All cameras together are therefore compared
at each of these motions. Of those that fit, the nearest to the nominal motion is taken, since a belt keeps its speed
better than it jumps by a spacing; the links say that others fit too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.link import row_reach_mm

SIMILAR = 0.75
"""Share of the most links from which on another motion fits as well."""
APART_MM = 0.5
"""Least difference of two motions. Smaller ones are the same motion, measured on parts that lean."""


def has_rival(links: Sequence[Links]) -> bool:
    """Return whether the coarse search of a camera found another shift that fits similarly."""
    return any(e.rival_px is not None for e in links)


def possible_motions(links: Sequence[Links], cameras: Sequence[Camera], nominal_mm: Floats) -> list[Floats]:
    """Return the motions (2,) between two rows that one of the cameras allows, within the range of the coarse search.

    Args:
        links: the links between the two rows, one entry per camera.
        cameras: all cameras.
        nominal_mm: (2,) nominal motion between the two rows.
    """
    found: list[Floats] = []
    for e in links:
        if not len(e.a_px):
            continue
        camera = cameras[e.task.a[0]]
        own = np.median(camera.ground(e.b_px) - camera.ground(e.a_px), axis=0)
        found.append(own)
        if e.rival_px is not None and e.coarse_px is not None:
            middle = e.b_px.mean(axis=0)
            spacing = camera.ground(middle + np.subtract(e.rival_px, e.coarse_px)) - camera.ground(middle)
            found += [own + spacing, own - spacing]
    reach = row_reach_mm(nominal_mm) + APART_MM
    near = [motion for motion in found if (np.abs(motion - nominal_mm) <= reach).all()]
    return [one for n, one in enumerate(near) if all(np.hypot(*(one - other)) > APART_MM for other in near[:n])]
