"""Compare a result with the twin's truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from vaoi_station.model import Strict
from vaoi_station.simulation import Passage

View = Sequence[float]
"""The centre of a footprint in one frame: camera, row, and x and y in raw pixels."""


class Deviation(Strict):
    """Distances between the positions of result and truth over all views of all components, in px and in board mm."""

    views: int
    """Number of views of the truth that the result places."""
    unplaced: int
    """Number of views of the truth that the result does not place."""
    rms_px: float
    max_px: float
    rms_mm: float
    max_mm: float
    worst: str | None
    """Component, camera and row of the view with the largest distance."""


def compare_with_truth(
    truth: Mapping[str, Iterable[View]], found: Mapping[str, Iterable[View]], px_per_mm: Sequence[float]
) -> Deviation:
    """Compare the component positions of a result with the true ones, in raw pixels.

    Args:
        truth: true views of every component, by the component's address.
        found: views of the result, by address; views that the truth does not have are ignored.
        px_per_mm: resolution of each camera.
    """
    errors: list[tuple[float, float, str]] = []
    unplaced = 0
    for address, views in truth.items():
        places = {(int(camera), int(row)): (x, y) for camera, row, x, y in found.get(address, ())}
        for camera, row, x, y in views:
            place = places.get((int(camera), int(row)))
            if place is None:
                unplaced += 1
                continue
            off_px = math.hypot(place[0] - x, place[1] - y)
            errors.append((off_px, off_px / px_per_mm[int(camera)], f"{address}, camera {camera:.0f}, row {row:.0f}"))
    px, mm = (np.array([e[k] for e in errors] or [0.0]) for k in (0, 1))
    return Deviation(
        views=len(errors),
        unplaced=unplaced,
        rms_px=_rms(px),
        max_px=round(float(px.max()), 5),
        rms_mm=_rms(mm),
        max_mm=round(float(mm.max()), 5),
        worst=max(errors)[2] if errors else None,
    )


def true_speed_mm_s(passage: Passage) -> float:
    """Return the true speed of the board's centre, from the least-squares line through its positions at the pulses."""
    board = passage.twin.scenario.board
    middle = np.array([board.width_mm / 2, board.length_mm / 2, 1.0])
    places_mm = np.array([(passage.pose(t) @ middle)[:2] for t in passage.pulse_times_s])
    times_s = np.array(passage.pulse_times_s)
    centred_s = times_s - times_s.mean()
    return float(np.hypot(*(centred_s @ places_mm / (centred_s @ centred_s))))


def _rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 5)
