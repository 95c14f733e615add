"""Places that do not follow C: of the boards of a panel, and of components beside local fiducials.

Boards of a panel are shifted and turned against each other by tenths of a millimetre. Artwork stretches and bends, so
that C puts a fine-pitch component hundredths of a millimetre from its pads. The fiducials of a board, and local ones
beside a component, have no part in C (`BoardType.apart_from_c`, `fiducials.LOCAL_MM`), unless they alone locate the
panel: what remains between their pictures and C is the displacement of their board or component.
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

_LOCAL_LIMIT_MM, _BOARD_LIMIT_MM = 0.3, 1.0
"""Largest accepted displacement of a component and of a board: artwork bends by less."""
_AGREEMENT_MM = 0.1
"""Largest difference of the displacements of two local fiducials of one component, and largest distance of a fiducial
from the place that shift and turn of its board give it."""
_TURN_RAD, _UNPLACED_MM = np.radians(0.1), 0.15
"""Standard deviation of the turn of a board that one fiducial places, and least one of the places on a board that its
fiducials do not place."""
_ARTWORK_MM, _MARK_MM = 0.02, 0.005
"""Standard deviations of what artwork displaces: all local fiducials of one component together, and each of them."""
_COMMON_SIGMAS, _LEAST_LOCAL = 3.0, 3
"""Number of standard deviations from which on a displacement common to local fiducials counts, and least number of
these fiducials."""
_COMMON_PX = 0.004
"""Error that all detections of a mark have in common (docs/explanation/uncertainty.md)."""


@dataclass(frozen=True, eq=False)
class OwnPlace:
    """The displacement of a board of a panel, or of a component, against C, as its fiducials show it."""

    fiducials: tuple[str, ...]
    lost: tuple[str, ...] = ()
    """Names of its fiducials that were not found; of a component, only if none was."""
    shift_mm: Floats = field(default_factory=lambda: np.zeros(2))
    """(2,) displacement of the component's centre, or of the middle of the board's components, tester coordinates."""
    turn_rad: float = 0.0
    sigma_mm: float = 0.0
    """Standard deviation of the shift, per axis; of every place on a board that follows C."""
    sigma_turn_rad: float = 0.0
    middle_mm: Floats = field(default_factory=lambda: np.zeros(2))
    """(2,) middle of the found fiducials by C, tester coordinates."""
    off_mm: float = 0.0
    matrix: Floats | None = None
    """C of this board or component (3, 3); None if it follows the panel's or the board's C."""
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class OwnPlaces:
    """What the fiducials of boards and of components show of places that C does not give."""

    boards: dict[str, OwnPlace] = field(default_factory=dict)
    local: dict[str, OwnPlace] = field(default_factory=dict)
    matrices: dict[str, Floats] = field(default_factory=dict)
    """C (3, 3) of each component that does not follow C of the panel or board, by address."""
    sigma_mm: dict[str, float] = field(default_factory=dict)
    """Standard deviation of these places beyond that of C, per axis, by address of the component."""

    @property
    def of_boards(self) -> dict[str, Floats]:
        """C (3, 3) of each board of a panel that its fiducials place, by position."""
        return {position: place.matrix for position, place in self.boards.items() if place.matrix is not None}


def own_places(plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, cad_matrix: Floats) -> OwnPlaces:
    """Return the places that do not follow C; local fiducials place their component on its board."""
    boards = board_places(plane, adjusted, points, cad_matrix)
    places = OwnPlaces(boards)
    local = local_places(plane, adjusted, points, cad_matrix, places.of_boards)
    for position, board in boards.items():
        parts = [c for c in plane.board_type.components if str(c.panel) == position]
        arm = np.hypot(*(apply(cad_matrix, np.array([c.center for c in parts])) - board.middle_mm).T)
        sigma = np.hypot(board.sigma_mm, board.sigma_turn_rad * arm).tolist()
        places.sigma_mm.update(zip((c.address for c in parts), sigma, strict=True))
        if board.matrix is not None:
            places.matrices.update({c.address: board.matrix for c in parts})
    for address, place in local.items():
        if place.matrix is not None:
            places.matrices[address], places.sigma_mm[address] = place.matrix, place.sigma_mm
    return replace(places, local=local)


class ShiftAndTurn(NamedTuple):
    """A rigid motion of the board plane, tester coordinates."""

    matrix: Floats
    """(3, 3) from the place by C to the place that the fiducials show."""
    turn_rad: float
    middle_mm: Floats
    spread_mm2: float
    """Sum of the squared distances of the fiducials from their middle: the σ of the turn is σ of one / √spread."""


def fit_shift_and_turn(at: Floats, shifts: Floats) -> ShiftAndTurn:
    """Fit shift and turn to displacements (k, 2) of k ≥ 1 fiducials, which C puts at `at` (k, 2), mm."""
    middle, shift = at.mean(0), shifts.mean(0)
    arm = at - middle
    spread, turn = float((arm**2).sum()), 0.0
    if len(at) > 1:
        turn = float((arm[:, 0] * shifts[:, 1] - arm[:, 1] * shifts[:, 0]).sum()) / spread
    matrix, c, s = np.eye(3), np.cos(turn), np.sin(turn)
    matrix[:2, :2] = ((c, -s), (s, c))
    matrix[:2, 2] = middle + shift - matrix[:2, :2] @ middle
    return ShiftAndTurn(matrix, turn, middle, spread)


def _displacements(
    points: FiducialPoints, residual_px: Floats, numbers: Collection[int]
) -> dict[int, tuple[Floats, float]]:
    """Return the mean displacement (2,) against C, mm, and its σ, of those fiducials that were found."""
    out = {}
    for n in numbers:
        mine = points.which == n
        if mine.any():
            off = residual_px[mine] / points.px_per_mm[mine, None]
            own = np.maximum(points.sigma_mm[mine] ** 2 - LOCAL_MM**2, 0.0).mean()
            scatter = float(off.var(axis=0, ddof=1).mean()) if len(off) > 1 else 0.0
            common = (_COMMON_PX / float(points.px_per_mm[mine].mean())) ** 2
            out[n] = off.mean(0), float(np.sqrt(max(own, scatter) / len(off) + common))
    return out


def local_places(
    plane: BoardPlane,
    adjusted: AdjustmentResult,
    points: FiducialPoints,
    cad_matrix: Floats,
    of_boards: Mapping[str, Floats],
) -> dict[str, OwnPlace]:
    """Return the places of components that have local fiducials, by address.

    `of_boards` holds C of the boards of a panel that have one, by position; it takes the place of `cad_matrix`.
    """
    board, cad, wanted = plane.board_type, plane.cad(plane.fiducials), dict[str, list[int]]()
    local, names = sorted(board.local_fiducials), [f.name for f in board.fiducials]
    measured = _displacements(points, adjusted.fiducial_px, local)
    for n in local:
        for address in board.fiducials[n].components or ():
            wanted.setdefault(address, []).append(n)
    out = {}
    for component in board.components if wanted else ():
        numbers = wanted.get(component.address, [])
        seen = [n for n in numbers if n in measured]
        if not numbers:
            continue
        if not seen:
            lost = tuple(names[n] for n in numbers)
            out[component.address] = OwnPlace((), lost, refusal=f"{', '.join(lost)} was not found")
            continue
        matrix = of_boards.get(str(component.panel), cad_matrix)
        at = apply(matrix, cad[seen])
        # Displacements were measured against C of the panel.
        shifts = np.array([measured[n][0] for n in seen]) - (at - apply(cad_matrix, cad[seen]))
        sigmas = np.array([measured[n][1] for n in seen])
        body = np.vstack([[component.center], board.footprint(component)])
        out[component.address] = _placed_part(tuple(names[n] for n in seen), at, shifts, sigmas, matrix, body)
    return out


def _placed_part(
    names: tuple[str, ...], at: Floats, shifts: Floats, sigmas: Floats, cad_matrix: Floats, body: Floats
) -> OwnPlace:
    """Fit a shift, and with several fiducials a turn, to the displacements (k, 2) of a component's fiducials.

    C puts them at `at` (k, 2); `body` (5, 2) are centre and corners of the component, CAD coordinates.
    """
    matrix, turn, middle, spread = fit_shift_and_turn(at, shifts)
    own, place = matrix @ cad_matrix, apply(cad_matrix, body)
    moved, sigma, refusal = apply(own, body) - place, float(np.sqrt((sigmas**2).sum())) / len(at), ""
    if len(at) > 1:
        sigma = float(np.hypot(sigma, float(np.sqrt((sigmas**2).mean() / spread)) * np.hypot(*(place[0] - middle))))
    # A turn explains any error of one fiducial of two across their distance, so the displacements themselves are
    # compared.
    apart = float(np.hypot(*(shifts[:, None] - shifts[None]).reshape(-1, 2).T).max())
    if (off := float(np.hypot(*np.vstack([moved, shifts]).T).max())) > _LOCAL_LIMIT_MM:
        refusal = f"{', '.join(names)} would displace it by {off:.2f} mm (limit {_LOCAL_LIMIT_MM:g} mm)"
    elif apart > _AGREEMENT_MM:
        refusal = f"{', '.join(names)} disagree by {apart:.2f} mm (limit {_AGREEMENT_MM:g} mm)"
    out = OwnPlace(names, (), moved[0], turn, sigma, middle_mm=middle, refusal=refusal)
    return out if refusal else replace(out, matrix=own)


def common_displacement_mm(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, cad_matrix: Floats
) -> float:
    """Return the largest displacement of local fiducials that one shift, turn and stretch explains; 0 if it is noise.

    Artwork displaces the fiducials of one component independently of those of others. What all have in common is an
    error of C. Fewer than three fiducials, or those of one component, do not show it.
    """
    # Boards of a panel lie displaced, and their local fiducials with them.
    local = [] if plane.board_type.board_fiducials else sorted(plane.board_type.local_fiducials)
    measured = _displacements(points, adjusted.fiducial_px, local)
    parts = [plane.board_type.fiducials[n].components for n in measured]
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


def board_places(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, cad_matrix: Floats
) -> dict[str, OwnPlace]:
    """Return the places of the boards of a panel, by position; empty if no board has fiducials."""
    board, out = plane.board_type, dict[str, OwnPlace]()
    found = set(points.which[points.which >= 0].tolist())
    apart = board.apart_from_c(found, points.fixture_marks)
    names, at = [f.name for f in board.fiducials], apply(cad_matrix, plane.cad(plane.fiducials))
    for position, numbers in board.board_fiducials.items():
        seen, of_c = [n for n in numbers if n in found], not apart.intersection(numbers)
        place = OwnPlace(tuple(names[n] for n in seen), tuple(names[n] for n in numbers if n not in found))
        if of_c and len(seen) > 1:
            # It is the board that determines C.
            out[position] = replace(place, matrix=cad_matrix)
        elif of_c and seen:
            # C is drawn to the fiducials of several displaced boards, so that their residuals show no displacement.
            refusal = f"{place.fiducials[0]} alone was found, and not two of the panel's own"
            out[position] = replace(place, refusal=refusal)
        elif not seen:
            out[position] = replace(place, refusal=f"{', '.join(place.lost)} was not found")
        else:
            centers = np.array([c.center for c in board.components if str(c.panel) == position])
            values = _displacements(points, adjusted.fiducial_px, seen).values()
            shifts, sigmas = np.array([shift for shift, _ in values]), np.array([sigma for _, sigma in values])
            out[position] = _placed_board(place, at[seen], shifts, sigmas, cad_matrix, apply(cad_matrix, centers))
    # A board that follows C is as uncertain as the other boards are displaced.
    moved = [place.shift_mm for place in out.values() if place.matrix is not None]
    sigma = max(_UNPLACED_MM, float(np.sqrt(np.mean(np.square(moved)))) if moved else 0.0)
    return {
        position: place if place.matrix is not None else replace(place, sigma_mm=sigma, sigma_turn_rad=0.0)
        for position, place in out.items()
    }


def _placed_board(
    place: OwnPlace, at: Floats, shifts: Floats, sigmas: Floats, cad_matrix: Floats, centers: Floats
) -> OwnPlace:
    """Fit shift and turn of a board to the displacements (k, 2) of its fiducials, which C puts at `at` (k, 2).

    `centers` (n, 2) is where C puts the components of the board.
    """
    matrix, turn, middle, spread = fit_shift_and_turn(at, shifts)
    left, every = at + shifts - apply(matrix, at), np.vstack([centers, at])
    off, variance, sigma_turn = float(np.hypot(*left.T).max()), float((sigmas**2).mean()), float(_TURN_RAD)
    if len(at) > 1:
        # Fiducials that disagree show less than their own standard deviations state.
        variance = max(variance, float((left**2).sum()) / (2 * len(at) - 3))
        sigma_turn = float(np.sqrt(variance / spread))
    moved, refusal = apply(matrix, every) - every, ""
    if (far := float(np.hypot(*moved.T).max())) > _BOARD_LIMIT_MM:
        refusal = f"{', '.join(place.fiducials)} would displace it by {far:.2f} mm (limit {_BOARD_LIMIT_MM:g} mm)"
    elif off > _AGREEMENT_MM:
        refusal = f"{', '.join(place.fiducials)} lie {off:.2f} mm from their places on it (limit {_AGREEMENT_MM:g} mm)"
    return replace(
        place,
        shift_mm=moved[: len(centers)].mean(0),
        turn_rad=turn,
        sigma_mm=float(np.sqrt(variance / len(at))),
        sigma_turn_rad=sigma_turn,
        middle_mm=middle,
        off_mm=off,
        matrix=None if refusal else matrix @ cad_matrix,
        refusal=refusal,
    )


def components_of(plane: BoardPlane, positions: Collection[str]) -> frozenset[str]:
    """Return the addresses of the components of the boards at these positions."""
    parts = plane.board_type.components if positions else ()
    return frozenset(c.address for c in parts if c.panel is not None and str(c.panel) in positions)


def placed_landmarks(plane: BoardPlane, cad_matrix: Floats, matrices: Mapping[str, Floats]) -> Floats:
    """Return the `landmarks` (n, 2) of a board such that C puts each where it lies."""
    parts = placed_parts(plane, cad_matrix, matrices)
    return parts.center if parts.addresses else landmarks(plane)[1]


def placed_parts(plane: BoardPlane, cad_matrix: Floats, matrices: Mapping[str, Floats]) -> ComponentIndex:
    """Return the components of a board such that C puts each where it lies; `matrices` are their own C, by address."""
    back = np.linalg.inv(cad_matrix)
    return plane.components.moved({address: back @ matrix for address, matrix in matrices.items()})
