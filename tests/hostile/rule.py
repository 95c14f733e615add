"""The written rule: in which drawings a right answer is expected, decided before the station has seen them.

It knows the scenario and the geometry of the film, and nothing of the station.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from tests.hostile.filming import Film
from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.board.layout import Part

LEAST_APART = 0.4
"""Least distance of two fiducials in view, as a share of the board's diagonal."""
LEAST_OVERLAP = 0.25
"""Least share of a frame's height that the next row of the same camera shows again."""
CLEAR, RIM_PX = 2.0, 6.0
"""Diameter of the bare area that a fiducial needs, in diameters of the fiducial (IPC-7351 asks for it), and the margin
of this area to the border of a frame."""
_BORDERS = np.linspace(-0.5, 0.5, 7)
"""Places along a footprint, as shares of its size, that contain its borders."""
PATCH_PX = 12.0
"""Distance from the border of both frames within which an overlap has no room for a patch that is compared."""
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
    elif blank := blank_overlap(film):
        yield f"two fiducials under different cameras, and cameras {blank[0]} and {blank[1]} share no component"
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


def blank_overlap(film: Film) -> tuple[int, int] | None:
    """Return two neighbouring cameras between two fiducials whose frames of one row have no component in common.

    The height of the board then leaves the distance of the cameras open, and with it the turn of the board. None if
    there are more than two fiducials, if one camera shows both, or if every overlap between them shows a component.
    """
    marks = film.twin.scenario.board.marks
    margin = CLEAR * max(m.diameter_mm for m in marks) / 2 * film.twin.scenario.array.px_per_mm + RIM_PX
    cameras = range(len(film.passage.pinholes))
    shown = [[bool(_in_frames(film, np.array([(m.x_mm, m.y_mm)]), margin, (c,)).any()) for c in cameras] for m in marks]
    if len(marks) != 2 or any(map(all, zip(*shown, strict=True))):
        return None
    first, last = sorted(own.index(True) for own in shown)
    for pair in pairwise(range(first, last + 1)):
        if not any(_in_frames(film, _footprint(part, _BORDERS), PATCH_PX, pair).any() for part in film.twin.parts):
            return pair
    return None


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
    steps = _BORDERS if borders else (np.arange(15) + 0.5) / 15 - 0.5
    for part in film.twin.parts:
        share = min(share, float(_inside(film, _footprint(part, steps), 0.0).mean()))
    return share


def _footprint(part: Part, steps: Floats) -> Floats:
    """Return the points (k², 2) of a grid on a footprint, in board coordinates, from k shares of its size."""
    return part.to_board(np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * part.package.size)


def _inside(film: Film, board_mm: Floats, margin_px: float) -> np.ndarray:
    """Return which points (k, 2) on the board at least one frame shows, (k,)."""
    seen = [_in_frames(film, board_mm, margin_px, (c,)) for c in range(len(film.passage.pinholes))]
    return np.asarray(np.any(seen, axis=0))


def _in_frames(film: Film, board_mm: Floats, margin_px: float, cameras: tuple[int, ...]) -> np.ndarray:
    """Return which points (k, 2) on the board the frames of all given cameras show in one row, (k,)."""
    array = film.twin.scenario.array
    limit = np.array([array.width_px - 1, array.height_px - 1]) - margin_px
    seen = np.zeros(len(board_mm), bool)
    for row in {row for _, row in film.filmed}:
        if all((camera, row) in film.filmed for camera in cameras):
            pixels = np.array([film.true_px((camera, row), board_mm) for camera in cameras])
            seen |= ((pixels >= margin_px) & (pixels <= limit)).all((0, 2))
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
