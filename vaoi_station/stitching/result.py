"""Build the result of a run from its findings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, Status, Stitch
from vaoi_station.stitching.board.footprints import views_by_address
from vaoi_station.stitching.quality.findings import Findings


def build_result(
    findings: Findings, method: str, status: Status, reasons: tuple[Reason, ...], quality: dict[str, Any]
) -> Stitch:
    """Return the result document: matrices, surface, positions of components, and the verdict."""
    matrix = findings.cad_matrix
    # model_construct skips validation: the values are computed here, and a large board has thousands of entries
    return Stitch.model_construct(
        method=method,
        image_matrices=tuple(_image_matrices(findings)),
        camera_matrices=tuple(_read_only(c.image_from_row.matrix) for c in findings.scene.cameras),
        cad_matrix=None if matrix is None else _read_only(matrix),
        row_motion=tuple(_read_only(findings.adjusted.motion.rows_from_tester)),
        status=status,
        reasons=tuple(reason.text for reason in reasons),
        reason_codes=tuple(reason.code.value for reason in reasons),
        quality=quality,
        surface=findings.surface,
        components=_component_views(findings),
        local_matrices=_local_matrices(findings),
        board_matrices=_board_matrices(findings),
        skipped_boards=tuple(at for at, marks in findings.bad_marks.items() if marks.state == "bad") or None,
    )


def _image_matrices(findings: Findings) -> Iterator[tuple[NDArray[Any] | None, ...]]:
    """Yield for each camera i the matrices M_ij of all rows j; None for a frame that has no place on the board."""
    rows = findings.adjusted.motion.rows_from_tester
    for i, camera in enumerate(findings.scene.cameras):
        matrices = _read_only(camera.image_from_row.matrix @ rows)
        yield tuple(m if findings.places(i, j) else None for j, m in enumerate(matrices))


def _component_views(findings: Findings) -> dict[str, tuple[tuple[int, int, float, float], ...]] | None:
    """Return the footprint views (camera, row, x, y) of each component, by its address; None without a CAD mapping."""
    if findings.plane is None or findings.views is None:
        return None
    addresses = findings.plane.components.addresses
    return views_by_address(addresses, findings.views) if addresses else {}


def _local_matrices(findings: Findings) -> dict[str, Floats] | None:
    """Return C of the components that local fiducials place, by address; None without any."""
    places = findings.own_places.local.items()
    return {ref: _read_only(place.matrix) for ref, place in places if place.matrix is not None} or None


def _board_matrices(findings: Findings) -> dict[str, Floats] | None:
    """Return C of the boards of a panel that their fiducials place, by position; None without any."""
    return {position: _read_only(matrix) for position, matrix in findings.own_places.of_boards.items()} or None


def _read_only(matrices: Floats) -> Floats:
    """Return a read-only copy of matrices: results are used in several places."""
    out = matrices.copy()
    out.setflags(write=False)
    return out
