"""Places of components that do not follow C: those on boards of a panel, and those beside local fiducials.

Shift and turn that the displacements of a few fiducials show: of a board of a panel, or of one component.

Places of components by their local fiducials, in place of C.

Artwork stretches and bends, so C puts a fine-pitch component hundredths of a millimetre from its pads. Local fiducials
lie beside these pads. They have no part in C (`fiducial_assignment.LOCAL_MM`): what remains between their pictures and
C is the displacement of their component.

Places of the boards of a panel by their fiducials, in place of the panel's C.

The boards of a panel are shifted and turned against each other by tenths of a millimetre, because panels are assembled
of boards, and because their webs give way. The fiducials of a board have no part in C (`BoardType.apart_from_c`),
unless they alone locate the panel: what remains between their pictures and C is the displacement of their board.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane, landmarks
from vaoi_station.stitching.board.fiducials import LOCAL_MM
from vaoi_station.stitching.geometry import ComponentIndex


class ShiftAndTurn(NamedTuple):
    """A rigid motion of the board plane, tester coordinates."""

    matrix: Floats
    """(3, 3) from the place by C to the place that the fiducials show."""
    turn_rad: float
    """Turn about the middle of the fiducials; 0 with one fiducial."""
    middle_mm: Floats
    """(2,) middle of the fiducials by C."""
    spread_mm2: float
    """Sum of the squared distances of the fiducials from their middle: the σ of the turn is σ of one / √spread."""


def fit_shift_and_turn(at: Floats, shifts: Floats) -> ShiftAndTurn:
    """Fit shift and turn to displacements by least squares, with equal weights; one fiducial shows a shift only.

    The turn is the sine of the angle. Up to 0.5° the difference is at most 1.2e-7 rad.

    Args:
        at: (k, 2) where C puts k ≥ 1 fiducials, tester coordinates, mm.
        shifts: (k, 2) their displacements, mm.
    """
    middle, shift = at.mean(0), shifts.mean(0)
    arm = at - middle
    spread, turn = float((arm**2).sum()), 0.0
    if len(at) > 1:
        turn = float((arm[:, 0] * shifts[:, 1] - arm[:, 1] * shifts[:, 0]).sum()) / spread
    matrix = np.eye(3)
    c, s = np.cos(turn), np.sin(turn)
    matrix[:2, :2] = ((c, -s), (s, c))
    matrix[:2, 2] = middle + shift - matrix[:2, :2] @ middle
    return ShiftAndTurn(matrix, turn, middle, spread)


LOCAL_LIMIT_MM = 0.3
"""Largest displacement of a component that is accepted: artwork does not bend by more; a wrong mark may lie so far."""
LOCAL_AGREEMENT_MM = 0.1
"""Largest difference of the displacements of two local fiducials of one component."""
_ARTWORK_MM, _MARK_MM = 0.02, 0.005
"""Standard deviations of what artwork displaces: all local fiducials of one component together, and each of them."""
_COMMON_SIGMAS, _LEAST_LOCAL = 3.0, 3
"""Number of standard deviations from which on a displacement common to local fiducials counts, and least number of
these fiducials."""
_COMMON_PX = 0.004
"""Error that all detections of a mark have in common (docs/measured/uncertainty.md)."""


@dataclass(frozen=True, eq=False)
class LocalPlace:
    """The displacement of a component against C, as its local fiducials show it."""

    fiducials: tuple[str, ...]
    """Names of the local fiducials that were found."""
    shift_mm: Floats
    """(2,) displacement of the component's centre, tester coordinates."""
    turn_rad: float
    """Turn of the component; 0 with one fiducial."""
    sigma_mm: float
    """Standard deviation of the displacement, per axis."""
    matrix: Floats | None
    """C of this component (3, 3); None if the displacement is refused."""
    refusal: str = ""
    """Why it is refused."""
    lost: tuple[str, ...] = ()
    """Names of its local fiducials, if none was found."""


def local_places(
    plane: BoardPlane,
    adjusted: AdjustmentResult,
    points: FiducialPoints | None,
    cad_matrix: Floats,
    of_boards: Mapping[str, Floats] | None = None,
) -> dict[str, LocalPlace]:
    """Return the places of components that have local fiducials, by address.

    Args:
        plane: plane of the board type.
        adjusted: solution of the adjustment.
        points: fiducial points of that adjustment.
        cad_matrix: C, (3, 3).
        of_boards: C of the boards of a panel that have one, by position; it takes the place of `cad_matrix`.
    """
    board = plane.board_type
    if points is None:
        return {}
    measured = {n: displacement(points, adjusted.fiducial_px, n) for n in sorted(board.local_fiducials)}
    by_panel, cad = apply(cad_matrix, plane.cad(plane.fiducials)), plane.cad(plane.fiducials)
    wanted: dict[str, list[int]] = {}
    for n in sorted(board.local_fiducials):
        for address in board.fiducials[n].components or ():
            wanted.setdefault(address, []).append(n)
    out = {}
    for component in board.components:
        numbers = wanted.get(component.address)
        if numbers is None:
            continue
        found = [n for n in numbers if measured[n] is not None]
        names = tuple(board.fiducials[n].name for n in found)
        if not found:
            lost = tuple(board.fiducials[n].name for n in numbers)
            text = f"{', '.join(lost)} was not found"
            out[component.address] = LocalPlace((), np.zeros(2), 0.0, 0.0, None, text, lost)
            continue
        values = [value for n in found if (value := measured[n]) is not None]
        shifts, sigmas = np.array([shift for shift, _ in values]), np.array([sigma for _, sigma in values])
        body = np.vstack([[component.center], board.footprint(component)])
        matrix = (of_boards or {}).get(str(component.panel), cad_matrix)
        at = apply(matrix, cad[found])
        # Displacements were measured against C of the panel.
        shifts = shifts - (at - by_panel[found])
        out[component.address] = _placed_part(names, at, shifts, sigmas, matrix, body)
    return out


def common_displacement_mm(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, cad_matrix: Floats
) -> float:
    """Return the largest displacement of local fiducials that one shift, turn and stretch explains; 0 if it is noise.

    Artwork displaces the fiducials of one component independently of those of others. What all have in common is an
    error of C. Fewer than three fiducials, or those of one component, do not show it.

    Args:
        plane: plane of the board type.
        adjusted: solution of the adjustment.
        points: fiducial points of that adjustment.
        cad_matrix: C, (3, 3).
    """
    fiducials = plane.board_type.fiducials
    # Boards of a panel lie displaced, and their local fiducials with them.
    local = [] if plane.board_type.board_fiducials else sorted(plane.board_type.local_fiducials)
    measured = {n: value for n in local if (value := displacement(points, adjusted.fiducial_px, n)) is not None}
    parts = [fiducials[n].components for n in measured]
    if len(measured) < _LEAST_LOCAL or len(set(parts)) < 2:
        return 0.0
    at = apply(cad_matrix, plane.cad(plane.fiducials))[list(measured)]
    x, y = (at - at.mean(0)).T / max(float(np.ptp(at, axis=0).max()), 1.0)
    one, none = np.ones(len(at)), np.zeros(len(at))
    design = np.vstack([np.stack([one, none, -y, x], 1), np.stack([none, one, x, y], 1)])
    together = np.array([[_ARTWORK_MM**2 if a == b else 0.0 for a in parts] for b in parts])
    own = np.diag([sigma**2 + _MARK_MM**2 for _, sigma in measured.values()])
    weight = np.kron(np.eye(2), np.linalg.inv(together + own))
    off = np.array([shift for shift, _ in measured.values()]).T.ravel()
    covariance = np.linalg.inv(design.T @ weight @ design)
    fitted = design @ covariance @ design.T @ weight @ off
    # Fiducials that disagree among themselves show less of what they have in common.
    scatter = max(1.0, float((off - fitted) @ weight @ (off - fitted)) / (len(off) - 4))
    variance = (design @ covariance @ design.T).diagonal().reshape(2, -1).sum(0) * scatter / 2
    length = np.hypot(*fitted.reshape(2, -1))
    return float(length[length > _COMMON_SIGMAS * np.sqrt(variance)].max(initial=0.0))


def placed_landmarks(plane: BoardPlane, cad_matrix: Floats, matrices: Mapping[str, Floats]) -> Floats:
    """Return the `landmarks` (n, 2) of a board such that C puts each where it lies.

    A component that does not follow C is where C puts another point of the board.
    """
    parts = placed_parts(plane, cad_matrix, matrices)
    return parts.center if parts.addresses else landmarks(plane)[1]


def placed_parts(plane: BoardPlane, cad_matrix: Floats, matrices: Mapping[str, Floats]) -> ComponentIndex:
    """Return the components of a board such that C puts each where it lies; `matrices` are their own C, by address."""
    back = np.linalg.inv(cad_matrix)
    moves = {ref: back @ matrix for ref, matrix in matrices.items()}
    return plane.components.moved(moves) if moves else plane.components


def displacement(points: FiducialPoints, residual_px: Floats, number: int) -> tuple[Floats, float] | None:
    """Return the mean displacement (2,) of a fiducial against C, mm, and its standard deviation; None if not found."""
    mine = points.which == number
    if not mine.any():
        return None
    off = residual_px[mine] / points.px_per_mm[mine, None]
    own = np.maximum(points.sigma_mm[mine] ** 2 - LOCAL_MM**2, 0.0).mean()
    scatter = float(off.var(axis=0, ddof=1).mean()) if len(off) > 1 else 0.0
    common = (_COMMON_PX / float(points.px_per_mm[mine].mean())) ** 2
    return off.mean(0), float(np.sqrt(max(own, scatter) / len(off) + common))


def _placed_part(
    names: tuple[str, ...], at: Floats, shifts: Floats, sigmas: Floats, cad_matrix: Floats, body: Floats
) -> LocalPlace:
    """Fit a shift, and with several fiducials a turn, to the displacements of a component's fiducials.

    Args:
        names: the fiducials.
        at: (k, 2) where C puts them, tester coordinates.
        shifts: (k, 2) their displacements, mm.
        sigmas: (k,) standard deviations.
        cad_matrix: C.
        body: (5, 2) centre and corners of the component, CAD coordinates.
    """
    matrix, turn, middle, spread = fit_shift_and_turn(at, shifts)
    own = matrix @ cad_matrix
    sigma = float(np.sqrt((sigmas**2).sum())) / len(at)
    if len(at) > 1:
        reach = float(np.hypot(*(apply(cad_matrix, body[0]) - middle)))
        sigma = float(np.hypot(sigma, float(np.sqrt((sigmas**2).mean() / spread)) * reach))
    moved = apply(own, body) - apply(cad_matrix, body)
    refusal = ""
    # A turn explains any error of one fiducial of two across their distance, so the displacements themselves are
    # compared.
    apart = float(np.hypot(*(shifts[:, None] - shifts[None]).reshape(-1, 2).T).max())
    if (off := float(np.hypot(*np.vstack([moved, shifts]).T).max())) > LOCAL_LIMIT_MM:
        refusal = f"{', '.join(names)} would displace it by {off:.2f} mm (limit {LOCAL_LIMIT_MM:g} mm)"
    elif apart > LOCAL_AGREEMENT_MM:
        refusal = f"{', '.join(names)} disagree by {apart:.2f} mm (limit {LOCAL_AGREEMENT_MM:g} mm)"
    return LocalPlace(names, moved[0], turn, sigma, None if refusal else own, refusal)


BOARD_LIMIT_MM = 1.0
"""Largest displacement of a board that is accepted: a wrong mark may lie so far."""
BOARD_AGREEMENT_MM = 0.1
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
        out[position] = _placed_board(known, at[seen], shifts, sigmas, cad_matrix, centers[position])
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


def _placed_board(
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
    if far > BOARD_LIMIT_MM:
        refusal = f"{', '.join(known[0])} would displace it by {far:.2f} mm (limit {BOARD_LIMIT_MM:g} mm)"
    elif off > BOARD_AGREEMENT_MM:
        refusal = f"{', '.join(known[0])} lie {off:.2f} mm from their places on it (limit {BOARD_AGREEMENT_MM:g} mm)"
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


@dataclass(frozen=True, eq=False)
class OwnPlaces:
    """What the fiducials of boards and of components show of places that C does not give."""

    boards: dict[str, BoardPlace] = field(default_factory=dict)
    """Places of the boards of a panel, by position."""
    local: dict[str, LocalPlace] = field(default_factory=dict)
    """Places of components by their local fiducials, by address."""
    matrices: dict[str, Floats] = field(default_factory=dict)
    """C (3, 3) of each component that does not follow C of the panel or board, by address."""
    sigma_mm: dict[str, float] = field(default_factory=dict)
    """Standard deviation of these places beyond that of C, per axis, by address of the component."""

    @property
    def of_boards(self) -> dict[str, Floats]:
        """C (3, 3) of each board of a panel that its fiducials place, by position."""
        return {position: place.matrix for position, place in self.boards.items() if place.matrix is not None}


def own_places(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, cad_matrix: Floats
) -> OwnPlaces:
    """Return the places that do not follow C; local fiducials place their component on its board, wherever that lies.

    Args:
        plane: plane of the board type.
        adjusted: solution of the adjustment.
        points: fiducial points of that adjustment.
        cad_matrix: C, (3, 3).
    """
    boards = board_places(plane, adjusted, points, cad_matrix)
    of_boards = {position: place.matrix for position, place in boards.items() if place.matrix is not None}
    local = local_places(plane, adjusted, points, cad_matrix, of_boards)
    placed = {ref: place for ref, place in local.items() if place.matrix is not None}
    matrices = matrices_of_components(plane, boards)
    matrices |= {ref: place.matrix for ref, place in placed.items() if place.matrix is not None}
    sigma = sigmas_of_components(plane, boards, cad_matrix) | {ref: place.sigma_mm for ref, place in placed.items()}
    return OwnPlaces(boards, local, matrices, sigma)
