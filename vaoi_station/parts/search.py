"""Parts that do not lie near their place: where they may be, by correlation with the template in a wider patch."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vaoi_station.parts.patches import Grid
from vaoi_station.parts.registration import Floats32, Template, warp

_TURNS_DEG = (0, -4, 4, -8, 8, -12, 12, -16, 16, -20, 20, -24, 24)
_LEAST_PX = 5


class Found(NamedTuple):
    """A place where a part may lie."""

    pose: tuple[float, float, float]
    """Place in the wide patch, px from its centre, and turn, rad, as in `Fit`."""
    quarters: int
    """Turn of the template, quarters."""
    correlation: float


def search(
    wide: Floats32, wide_grid: Grid, templates: dict[int, Template], grid: Grid, *, weighted: bool = False
) -> Found | None:
    """Find a part in a wide patch, turned by up to 24° either way; None if the template is too small for it.

    `templates` are those of the kind by quarters of a turn, with patches as `grid` states. `weighted` lets their
    pixels count as their masks say, which takes five times as long.
    """
    factor = wide_grid.px_per_mm / grid.px_per_mm
    body = tuple(round((s + 2) * factor) for s in grid.body_px)
    if min(body) < _LEAST_PX:
        return None
    cut = {q: _body(t.picture, grid, factor, body) for q, t in templates.items()}
    masks = {q: _body(t.mask, grid, factor, body) if weighted else None for q, t in templates.items()}
    best: Found | None = None
    h, w = wide.shape
    for turn in _TURNS_DEG:
        angle = np.radians(turn)
        upright = warp(wide[None], np.array([[0.0, 0.0, angle]]))[0]
        for q, template in cut.items():
            if template.shape[0] > h or template.shape[1] > w:
                continue
            if weighted:
                # A plain body correlates with any ground; its brightness tells it.
                score = 1 - np.sqrt(cv2.matchTemplate(upright, template, cv2.TM_SQDIFF_NORMED, mask=masks[q]))
            else:
                score = cv2.matchTemplate(upright, template, cv2.TM_CCOEFF_NORMED)
            _, most, _, (x, y) = cv2.minMaxLoc(score)
            if best is None or most > best.correlation:
                u = x + (template.shape[1] - 1) / 2 - (w - 1) / 2
                v = y + (template.shape[0] - 1) / 2 - (h - 1) / 2
                c, s = np.cos(angle), np.sin(angle)
                best = Found((float(c * u - s * v), float(s * u + c * v), float(angle)), q, float(most))
    return best


def _body(picture: Floats32, grid: Grid, factor: float, size: tuple[int, ...]) -> Floats32:
    """Return the body in a template, at the resolution of a wide patch."""
    w, h = (s + 2 for s in grid.body_px)
    m = np.array(
        [[w / size[0], 0, (grid.width - w) / 2 + w / size[0] / 2 - 0.5],
         [0, h / size[1], (grid.height - h) / 2 + h / size[1] / 2 - 0.5]]
    )  # fmt: skip
    smooth = cv2.GaussianBlur(picture, (0, 0), max(0.5 / factor, 0.3))
    return np.asarray(cv2.warpAffine(smooth, m, (size[0], size[1]), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP))
