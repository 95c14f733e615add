"""Places of the boards of a panel by their fiducials, in place of the panel's C.

The boards of a panel are shifted and turned against each other by tenths of a millimetre, because panels are assembled
of boards, and because their webs give way. The fiducials of a board have no part in C (`BoardType.apart_from_c`),
unless they alone locate the panel: what remains between their pictures and C is the displacement of their board.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.local_fiducials import displacement
from vaoi_station.stitching.components.shift_and_turn import fit_shift_and_turn

LIMIT_MM = 1.0
"""Largest displacement of a board that is accepted: a wrong mark may lie so far."""
AGREEMENT_MM = 0.1
"""Largest distance of a fiducial from the place that the shift and turn of its board give it."""
_TURN_RAD = np.radians(0.1)
"""Standard deviation of the turn of a board that one fiducial places."""
_UNPLACED_MM = 0.15
"""Least standard deviation of the places on a board that its fiducials do not place."""


@dataclass(frozen=True, eq=False)
class BoardPlace:
    """The displacement of a board of a panel against C, as its fiducials show it."""

    fiducials: tuple[str, ...]
    """Names of its fiducials that were found."""
    lost: tuple[str, ...]
    """Names of its fiducials that were not found."""
    shift_mm: Floats
    """(2,) displacement of the middle of its components, tester coordinates."""
    turn_rad: float
    sigma_mm: float
    """Standard deviation of the shift at the middle of its fiducials, per axis; of every place if `matrix` is None."""
    sigma_turn_rad: float
    middle_mm: Floats
    """(2,) middle of the found fiducials by C, tester coordinates."""
    off_mm: float
    """Largest distance of a fiducial from the place that shift and turn give it."""
    matrix: Floats | None
    """C of this board (3, 3); None if it follows the panel's C."""
    refusal: str = ""
    """Why it follows the panel's C."""

    def sigma_at(self, tester_mm: Floats) -> Floats:
        """Return the standard deviation (k,) of places (k, 2) on the board, mm per axis, beyond that of C."""
        arm = np.hypot(*(tester_mm - self.middle_mm).T)
        return np.asarray(np.hypot(self.sigma_mm, self.sigma_turn_rad * arm))


def board_places(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, cad_matrix: Floats
) -> dict[str, BoardPlace]:
    """Return the places of the boards of a panel, by position; empty if no board has fiducials.

    Args:
        plane: plane of the board type.
        adjusted: solution of the adjustment.
        points: fiducial points of that adjustment.
        cad_matrix: C, (3, 3).
    """
    boards = plane.board_type.board_fiducials
    if not boards:
        return {}
    points = points if points is not None else FiducialPoints.empty()
    found = set(points.which[points.which >= 0].tolist())
    apart = plane.board_type.apart_from_c(found, points.fixture_marks)
    names = [f.name for f in plane.board_type.fiducials]
    at, centers = apply(cad_matrix, plane.cad(plane.fiducials)), _centers(plane, cad_matrix)
    out = {}
    for position, numbers in boards.items():
        seen = [n for n in numbers if n in found]
        known = tuple(names[n] for n in seen), tuple(names[n] for n in numbers if n not in found)
        of_c = not apart.intersection(numbers)
        if of_c and len(seen) > 1:
            # It is the board that determines C.
            out[position] = _unmoved(known, cad_matrix)
            continue
        if of_c and seen:
            # C is drawn to the fiducials of several displaced boards, so that their residuals show no displacement.
            out[position] = _unmoved(known, None, f"{known[0][0]} alone was found, and not two of the panel's own")
            continue
        values = [v for n in seen if (v := displacement(points, adjusted.fiducial_px, n)) is not None]
        if not values:
            out[position] = _unmoved(known, None, f"{', '.join(known[1] or known[0])} was not found")
            continue
        shifts, sigmas = np.array([shift for shift, _ in values]), np.array([sigma for _, sigma in values])
        out[position] = _placed(known, at[seen], shifts, sigmas, cad_matrix, centers[position])
    return _with_sigma_of_lost(out)


def matrices_of_components(plane: BoardPlane, places: Mapping[str, BoardPlace]) -> dict[str, Floats]:
    """Return C of each component whose board has one, by address."""
    own = {position: place.matrix for position, place in places.items() if place.matrix is not None}
    parts = plane.board_type.components if own else ()
    return {c.address: own[str(c.panel)] for c in parts if str(c.panel) in own}


def sigmas_of_components(plane: BoardPlane, places: Mapping[str, BoardPlace], cad_matrix: Floats) -> dict[str, float]:
    """Return the standard deviation of the board's place at each component of a panel, mm, by address."""
    out: dict[str, float] = {}
    for position, place in places.items():
        parts = [c for c in plane.board_type.components if str(c.panel) == position]
        sigma = place.sigma_at(apply(cad_matrix, np.array([c.center for c in parts])))
        out |= dict(zip((c.address for c in parts), sigma.tolist(), strict=True))
    return out


def components_of(plane: BoardPlane, positions: Collection[str]) -> frozenset[str]:
    """Return the addresses of the components of the boards at these positions."""
    parts = plane.board_type.components if positions else ()
    return frozenset(c.address for c in parts if c.panel is not None and str(c.panel) in positions)


def _centers(plane: BoardPlane, cad_matrix: Floats) -> dict[str, Floats]:
    """Return the centres (k, 2) of the components of each board by C, tester coordinates."""
    of: dict[str, list[tuple[float, float]]] = {}
    for c in plane.board_type.components:
        of.setdefault(str(c.panel), []).append(c.center)
    return {position: apply(cad_matrix, np.array(centers)) for position, centers in of.items()}


def _unmoved(known: tuple[tuple[str, ...], tuple[str, ...]], matrix: Floats | None, refusal: str = "") -> BoardPlace:
    """Return the place of a board without a displacement; `known` and `matrix` as of `BoardPlace`."""
    found, lost = known
    return BoardPlace(found, lost, np.zeros(2), 0.0, 0.0, 0.0, np.zeros(2), 0.0, matrix, refusal)


def _placed(
    known: tuple[tuple[str, ...], tuple[str, ...]],
    at: Floats,
    shifts: Floats,
    sigmas: Floats,
    cad_matrix: Floats,
    centers: Floats,
) -> BoardPlace:
    """Fit shift and turn of a board to the displacements of its fiducials.

    Args:
        known: names of the fiducials that were found, and of those that were not.
        at: (k, 2) where C puts the fiducials that were found, tester coordinates.
        shifts: (k, 2) their displacements, mm.
        sigmas: (k,) standard deviations.
        cad_matrix: C.
        centers: (n, 2) where C puts the components of the board.
    """
    matrix, turn, middle, spread = fit_shift_and_turn(at, shifts)
    left = at + shifts - apply(matrix, at)
    off = float(np.hypot(*left.T).max())
    variance = float((sigmas**2).mean())
    sigma_turn = _TURN_RAD
    if len(at) > 1:
        # Fiducials that disagree show less than their own standard deviations state.
        variance = max(variance, float((left**2).sum()) / (2 * len(at) - 3))
        sigma_turn = float(np.sqrt(variance / spread))
    moved = apply(matrix, np.vstack([centers, at]))
    far = float(np.hypot(*(moved - np.vstack([centers, at])).T).max())
    refusal = ""
    if far > LIMIT_MM:
        refusal = f"{', '.join(known[0])} would displace it by {far:.2f} mm (limit {LIMIT_MM:g} mm)"
    elif off > AGREEMENT_MM:
        refusal = f"{', '.join(known[0])} lie {off:.2f} mm from their places on it (limit {AGREEMENT_MM:g} mm)"
    sigma = float(np.sqrt(variance / len(at)))
    own = None if refusal else matrix @ cad_matrix
    shown = moved[: len(centers)].mean(0) - centers.mean(0)
    return BoardPlace(*known, shown, turn, sigma, sigma_turn, middle, off, own, refusal)


def _with_sigma_of_lost(places: dict[str, BoardPlace]) -> dict[str, BoardPlace]:
    """Return the places; a board that follows C is as uncertain as the other boards are displaced."""
    shifts = [place.shift_mm for place in places.values() if place.matrix is not None]
    scatter = float(np.sqrt(np.mean(np.square(shifts)))) if shifts else 0.0
    sigma = max(_UNPLACED_MM, scatter)
    return {
        position: place if place.matrix is not None else replace(place, sigma_mm=sigma, sigma_turn_rad=0.0)
        for position, place in places.items()
    }
