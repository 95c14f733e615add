"""What is drawn over the picture of a whole board, from the result of a run: it needs no frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vaoi_station.files.results import quality_of
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.states.schemas import OverlayFiducial, OverlayFrame, OverlayLinks, Point, RunOverlay


def overlay_of(finished: FinishedRun) -> RunOverlay:
    """Return frames, links and fiducials of a finished run, in CAD coordinates.

    Raises:
        NotFoundError: the run ended without a result.
        StateError: the run has no CAD mapping.
    """
    quality = quality_of(finished.text)
    stitch, board_type = finished.lean, finished.board_type
    projector = FrameIndex.of_result(stitch, finished.cameras)
    assert stitch.cad_matrix is not None, "the projector refuses a run without it"
    cad_from_tester: Floats = np.asarray(np.linalg.inv(stitch.cad_matrix), np.float64)
    return RunOverlay(
        unit=board_type.unit,
        px_per_mm=round(projector.px_per_mm, 6),
        outline=_outline(board_type),
        frames=tuple(_frames(finished, projector, quality)),
        links=tuple(_links(quality, cad_from_tester, projector.px_per_mm)),
        fiducials=tuple(_fiducials(board_type, quality, cad_from_tester, projector.px_per_mm)),
    )


def _outline(board_type: BoardType) -> tuple[Point, ...]:
    """Return the board's outline as a polygon; two opposite corners are a rectangle."""
    points = board_type.outline or ()
    if len(points) != 2:
        return tuple((x, y) for x, y in points)
    (x0, y0), (x1, y1) = points
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def _frames(finished: FinishedRun, projector: FrameIndex, quality: dict[str, Any]) -> Iterator[OverlayFrame]:
    sigma = quality.get("matrix_sigma_px") or []
    for frame in finished.detail.frames:
        i, j = frame.camera, frame.row
        if not projector.places(i, j):
            continue
        # [middle, corner] of every frame; None for one that was not placed, and no table in results of old versions.
        pair = sigma[i][j] if i < len(sigma) and j < len(sigma[i]) else None
        yield OverlayFrame(
            camera=i,
            row=j,
            usable=frame.usable,
            light=frame.light,
            corners=tuple(map(_point, projector.outline(i, j))),
            sigma_px=None if pair is None else pair[1],
        )


def _links(quality: dict[str, Any], cad_from_tester: Floats, px_per_mm: float) -> Iterator[OverlayLinks]:
    for pair in quality.get("link_pairs", ()):
        at, off = pair["at_mm"], pair["residual_px"]
        yield OverlayLinks(
            a=tuple(pair["a"]),
            b=tuple(pair["b"]),
            found=pair["found"],
            used=pair["used"],
            at=None if at is None else _point(apply(cad_from_tester, np.array(at))),
            residual=None if off is None else _vector(cad_from_tester, off, px_per_mm),
            residual_px=None if off is None else round(float(np.hypot(*off)), 4),
            rms_px=pair["rms_px"],
        )
    for pair in quality.get("unlinked", ()):
        a, b = pair["a"], pair["b"] or pair["a"]
        yield OverlayLinks(a=tuple(a), b=tuple(b), found=0, used=0, why=pair["reason"])


def _fiducials(
    board_type: BoardType, quality: dict[str, Any], cad_from_tester: Floats, px_per_mm: float
) -> Iterator[OverlayFiducial]:
    seen = {entry["name"]: entry for entry in quality.get("fiducials", ())}
    for mark in board_type.fiducials:
        entry = seen.get(mark.name, {})
        off = entry.get("residual_px")
        yield OverlayFiducial(
            name=mark.name,
            at=(mark.x, mark.y),
            diameter=mark.diameter,
            sightings=entry.get("sightings", 0),
            residual=None if off is None else _vector(cad_from_tester, off, px_per_mm),
            residual_px=None if off is None else round(float(np.hypot(*off)), 4),
        )


def _vector(cad_from_tester: Floats, off_px: list[float], px_per_mm: float) -> Point:
    """Return a residual along the tester's axes, px, as a vector in CAD units."""
    return _point(cad_from_tester[:2, :2] @ (np.array(off_px) / px_per_mm), digits=9)


def _point(values: Floats, digits: int = 6) -> Point:
    return round(float(values[0]), digits), round(float(values[1]), digits)
