"""Link the marks of consecutive rows (section 3.3.1 of the paper).

The nominal motion of the belt predicts where a mark appears in the next row. Its error is smaller than the distance
between two marks, so that the prediction identifies the mark.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.matching.evidence import Detections, Links, Task

_NEAR_MM = 1.2
"""Largest distance of a mark from the position that the nominal motion predicts."""


def mark_links(detections: Sequence[Detections], cameras: Sequence[Camera], nominal: Motion) -> list[Links]:
    """Link the marks of each camera in every row to those in the next row in which the camera detected marks.

    Marks with more than one possible partner are left out.
    """
    links = []
    for i, camera in enumerate(cameras):
        seen = sorted((s for s in detections if s.task.a[0] == i and len(s.px)), key=lambda s: s.task.a[1])
        for a, b in pairwise(seen):
            links.append(_link_marks(a, b, camera, nominal))
    return links


def _link_marks(a: Detections, b: Detections, camera: Camera, nominal: Motion) -> Links:
    """Link those marks of two frames of a camera that have exactly one possible partner each.

    Partners have the same kind and lie within `_NEAR_MM` of each other at nominal motion.
    """
    task = Task("rows", a.task.a, b.task.a)
    places = [nominal.board(np.full(len(s.px), s.task.a[1]), camera.ground(s.px)) for s in (a, b)]
    distance = np.hypot(*np.moveaxis(places[1][None] - places[0][:, None], 2, 0))
    distance[a.kind[:, None] != b.kind[None]] = np.inf
    k = np.flatnonzero((distance < _NEAR_MM).sum(1) == 1)
    n = distance[k].argmin(1)
    # The partner must not have a second mark near it either.
    alone = (distance[:, n] < _NEAR_MM).sum(0) == 1
    k, n = k[alone], n[alone]
    if not len(k):
        return Links.empty(task, "no mark is in both rows")
    variance = a.sigma_px[k] ** 2 + b.sigma_px[n] ** 2
    information = np.eye(2) / variance[:, None, None]
    return Links(task, a.px[k], b.px[n], information, np.minimum(a.score[k], b.score[n]))
