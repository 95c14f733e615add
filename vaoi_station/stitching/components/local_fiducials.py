"""Places of components by their local fiducials, in place of C.

Artwork stretches and bends, so C puts a fine-pitch component hundredths of a millimetre from its pads. Local fiducials
lie beside these pads. They have no part in C (`fiducial_assignment.LOCAL_MM`): what remains between their pictures and
C is the displacement of their component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.component_index import ComponentIndex
from vaoi_station.stitching.board.fiducial_assignment import LOCAL_MM
from vaoi_station.stitching.board.footprints import landmarks
from vaoi_station.stitching.components.shift_and_turn import fit_shift_and_turn

LIMIT_MM = 0.3
"""Largest displacement of a component that is accepted: artwork does not bend by more; a wrong mark may lie so far."""
AGREEMENT_MM = 0.1
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
        out[component.address] = _placed(names, at, shifts, sigmas, matrix, body)
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


def _placed(
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
    if (off := float(np.hypot(*np.vstack([moved, shifts]).T).max())) > LIMIT_MM:
        refusal = f"{', '.join(names)} would displace it by {off:.2f} mm (limit {LIMIT_MM:g} mm)"
    elif apart > AGREEMENT_MM:
        refusal = f"{', '.join(names)} disagree by {apart:.2f} mm (limit {AGREEMENT_MM:g} mm)"
    return LocalPlace(names, moved[0], turn, sigma, None if refusal else own, refusal)
