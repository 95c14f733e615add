"""Find cameras whose frames are in wrong rows: their overlaps match when the row of one camera is changed by one.

All cameras of a row are fired by one pulse, so neighbouring cameras show the same part of the board in the same row. If
they do not, either a camera has moved, or the frames of a camera are assigned to the row before or after
(`acquisition.pairing.latency`). In the second case, the overlap in row j of one camera matches row j ± 1 of the other
camera at the place that the calibration predicts. A moved camera would show this only if it had moved by exactly one
step of the belt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.link import link_in_place
from vaoi_station.stitching.matching.scene import Scene

_TRIED_ROWS = 4
"""Number of rows, for each pair of cameras, that are compared with the rows before and after them."""
_AGREEING = 2
"""Number of the compared rows in which most links must have the same offset."""
_PLAINLY = 2.0
"""Least ratio of the number of links at the offset to the number of links without offset."""
_LINKS = 12
"""Least number of links, in all compared rows together, by which frames count as frames of the same pulse."""
_AT_REST = np.zeros(2)


def row_offset(scene: Scene, links: Iterable[Links], left: int) -> int:
    """Return by how many rows (−1, 0, +1) the row numbers of camera left + 1 are too high against those of camera left.

    Args:
        scene: the frames of the run.
        links: the links of the run, by which rows with texture in the overlap are chosen.
        left: the lower number of the two cameras.
    """
    present = set(scene.present)
    seam = [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.tried]
    # Rows with most texture in the overlap decide best.
    votes, total = Counter[int](), Counter[int]()
    for e in sorted(seam, key=lambda e: (-e.tried, e.task.a))[:_TRIED_ROWS]:
        row = e.task.a[1]
        counts = {
            offset: _count_links(scene, (left, row), (left + 1, row + offset))
            for offset in (-1, 0, 1)
            if (left + 1, row + offset) in present
        }
        if not counts:
            continue
        total.update(counts)
        best = max(counts, key=lambda offset: counts[offset])
        votes[best] += counts[best] > 0
    best = max((-1, 0, 1), key=lambda offset: total[offset])
    plainly = total[best] >= _LINKS and total[best] >= _PLAINLY * total[0] and votes[best] >= _AGREEING
    return best if plainly else 0


def shifted_cameras(offsets: Mapping[tuple[int, int], int], cameras: int) -> dict[int, int]:
    """Return, for each camera with wrong row numbers, by how many rows they are too high; most cameras must be right.

    Args:
        offsets: for a pair of neighbouring cameras, the offset of the second against the first; 0 for pairs not listed.
        cameras: number of cameras.
    """
    place = [0]
    for i in range(cameras - 1):
        place.append(place[-1] + offsets.get((i, i + 1), 0))
    common, count = Counter(place).most_common(1)[0]
    # Of two cameras that disagree, it is not known which one is right.
    return {i: p - common for i, p in enumerate(place) if p != common} if 2 * count > cameras else {}


def _count_links(scene: Scene, a: FrameKey, b: FrameKey) -> int:
    """Count the links that are found between two frames if they are taken as frames of the same pulse."""
    cameras = scene.cameras[a[0]], scene.cameras[b[0]]
    pair = FramePair(scene.prepared(a), scene.prepared(b), *cameras, _AT_REST)
    return len(link_in_place(Task("neighbours", a, b), pair).a_px)
