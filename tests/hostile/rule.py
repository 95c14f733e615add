"""The written rule: in which drawings a right answer is expected, decided before the station has seen them.

It knows the scenario and the geometry of the film, and nothing of the station. docs/measured/hostile.md states it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from tests.hostile.filming import Film
from vaoi_station.geometry.transforms import Floats

LEAST_APART = 0.4
"""Least distance of two fiducials in view, as a share of the board's diagonal."""
LEAST_OVERLAP = 0.25
"""Least share of a frame's height that the next row of the same camera shows again."""
CLEAR, RIM_PX = 2.0, 6.0
"""Diameter of the bare area that a fiducial needs, in diameters of the fiducial (IPC-7351 asks for it), and the margin
of this area to the border of a frame."""
LEAST_SEEN = 0.999
"""Least share of every footprint that the frames show together."""


def why_impossible(film: Film) -> tuple[str, ...]:
    """Return why no right answer is expected of the station; empty if it is."""
    return tuple(_reasons(film))


def _reasons(film: Film) -> Iterator[str]:
    yield from (f"{m} is beyond its limit" for m in film.drawing.mistakes if not m.within)
    if not film.frames:
        yield "no frame arrives"
        return
    marks = fiducials_in_view(film)
    diagonal = float(np.hypot(film.twin.scenario.board.width_mm, film.twin.scenario.board.length_mm))
    if len(marks) < 2 or np.hypot(*(marks[:, None] - marks[None]).T).max() < LEAST_APART * diagonal:
        yield f"{len(marks)} fiducials in view, or too close together"
    elif _symmetric(film):
        yield "the fiducials fit a board that is turned by 180°"
    if (overlap := least_overlap(film)) < LEAST_OVERLAP:
        yield f"rows overlap by {overlap:.2f}"
    if (seen := least_seen(film)) < LEAST_SEEN:
        yield f"a footprint is in view by {seen:.2f} only"


def fiducials_in_view(film: Film) -> Floats:
    """Return the fiducials (k, 2), board mm, that at least one frame shows with the bare area around them."""
    marks = film.twin.scenario.board.marks
    if not marks:
        return np.zeros((0, 2))
    places = np.array([(m.x_mm, m.y_mm) for m in marks])
    array = film.twin.scenario.array
    margin = CLEAR * max(m.diameter_mm for m in marks) / 2 * array.px_per_mm + RIM_PX
    return np.asarray(places[_inside(film, places, margin)])


def least_overlap(film: Film) -> float:
    """Return the least overlap of consecutive rows that arrive, as a share of a frame's height."""
    rows = sorted({row for _, row in film.filmed})
    times = film.passage.pulse_times_s
    y = [film.passage.pose(times[r])[:2, 2] for r in rows]
    steps = [float(np.hypot(*(b - a))) for a, b in pairwise(y)]
    return 1 - max(steps, default=0.0) / film.twin.scenario.array.view_mm[1]


def least_seen(film: Film, *, borders: bool = True) -> float:
    """Return the share of the footprint that is in view least, of the board that was filmed.

    With `borders`, points on the border of a footprint count like those inside, so that hardly one may be out of view;
    without, the share is that of the area.
    """
    share = 1.0
    steps = np.linspace(-0.5, 0.5, 7) if borders else (np.arange(15) + 0.5) / 15 - 0.5
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for part in film.twin.parts:
        share = min(share, float(_inside(film, part.to_board(grid * part.package.size), 0.0).mean()))
    return share


def _inside(film: Film, board_mm: Floats, margin_px: float) -> np.ndarray:
    """Return which points (k, 2) on the board at least one frame shows, (k,)."""
    array = film.twin.scenario.array
    limit = np.array([array.width_px - 1, array.height_px - 1]) - margin_px
    seen = np.zeros(len(board_mm), bool)
    for key in film.filmed:
        pixels = film.true_px(key, board_mm)
        seen |= ((pixels >= margin_px) & (pixels <= limit)).all(1)
    return seen


def _symmetric(film: Film) -> bool:
    """Return whether a board that is turned by 180° has its fiducials at the same places, within 1 mm."""
    board = film.twin.scenario.board
    places = np.array([(m.x_mm, m.y_mm) for m in board.marks])
    turned = places.min(0) + places.max(0) - places
    nearest = np.hypot(*(places[:, None] - turned[None]).T).min(1)
    # Two marks always fit in both directions: what decides are the outline and the components.
    from_middle = np.abs((places.min(0) + places.max(0)) / 2 - (board.width_mm / 2, board.length_mm / 2)).max()
    return bool(nearest.max() < 1.0 and from_middle < 1.0)
