"""Places of components that do not follow C: those on boards of a panel, and those beside local fiducials."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.local_fiducials import LocalPlace, local_places
from vaoi_station.stitching.components.panel_boards import (
    BoardPlace,
    board_places,
    matrices_of_components,
    sigmas_of_components,
)


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
