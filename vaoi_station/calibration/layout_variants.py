"""Common mistakes in a layout (reflection, rotation, shift), by which a refusal can name the mistake."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

_MISTAKES = (
    ("mirrored in x", ((-1, 0), (0, 1))),
    ("mirrored in y", ((1, 0), (0, -1))),
    ("turned by 180°", ((-1, 0), (0, -1))),
    ("with x and y exchanged", ((0, 1), (1, 0))),
    ("turned by 90°", ((0, -1), (1, 0))),
    ("turned by -90°", ((0, 1), (-1, 0))),
)


def find_symmetries(marks_mm: Floats, tolerance_mm: float) -> tuple[str, ...]:
    """List the reflections and rotations that map a layout (k, 2) onto itself."""
    # Such a mistake cannot be detected in any frame, because the mistaken layout is the same as the true one.
    middle = (marks_mm.min(0) + marks_mm.max(0)) / 2
    found = []
    for name, linear in _MISTAKES:
        changed = (marks_mm - middle) @ np.array(linear, dtype=np.float64).T + middle
        apart = np.hypot(*np.moveaxis(changed[:, None] - marks_mm[None], 2, 0)).min(1)
        if apart.max() <= tolerance_mm:
            found.append(name)
    return tuple(found)


def vary_layout(marks_mm: Floats, heads: Sequence[CameraHead]) -> Iterator[tuple[str, Floats]]:
    """Yield the name of each common mistake, and the layout (k, 2) that it gives.

    Reflections and rotations are applied about the origin, about the layout's centre, and with a move of the layout's
    centre to the centre of the array.
    """
    views = np.array([h.nominal_center_mm or (0.0, 0.0) for h in heads])
    own, array = (marks_mm.min(0) + marks_mm.max(0)) / 2, (views.min(0) + views.max(0)) / 2
    about = [(np.zeros(2), np.zeros(2)), (own, own), (own, array)]
    for name, linear in _MISTAKES:
        seen: list[Floats] = []
        for before, after in about:
            changed = (marks_mm - before) @ np.array(linear, dtype=np.float64).T + after
            if not any(np.allclose(changed, s) for s in seen):
                seen.append(changed)
                yield name, changed
    x, y = array - own
    yield f"shifted by ({x:.1f}, {y:.1f}) mm", marks_mm + (x, y)
