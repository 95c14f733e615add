"""Reasons of a verdict about components that are centred elsewhere than C puts them."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.shift import ComponentShift
from vaoi_station.stitching.components.two_fiducials import likely_errors, two_that_place

_LIMIT_PX = 0.30
"""Largest error of one of two fiducials that is accepted, px: that of a fiducial's residual where there are more."""


def component_reasons(
    shift: ComponentShift | None,
    plane: BoardPlane,
    adjusted: AdjustmentResult,
    points: FiducialPoints | None,
    px_per_mm: float,
) -> list[Reason]:
    """Return a reason if the pictures of the components are centred elsewhere than C puts them.

    Args:
        shift: what the components show; None if they show nothing.
        plane: plane of the board type.
        adjusted: solution of the adjustment.
        points: fiducial points of that adjustment.
        px_per_mm: resolution of the station.
    """
    if shift is None or adjusted.similarity is None:
        return []
    places = apply(plane.matrix(adjusted.similarity), plane.cad(plane.fiducials))
    names = [fiducial.name for fiducial in plane.board_type.fiducials]
    if shift.contradicts:
        off_mm = np.hypot(*shift.at(places).T) if len(places) else np.zeros(0)
        where = ""
        if len(off_mm):
            n = int(off_mm.argmax())
            where = f", which is {off_mm[n]:.2f} mm ({off_mm[n] * px_per_mm:.1f} px) at fiducial {names[n]}"
        (x, y), (sx, sy) = shift.measured[:2], np.sqrt(np.diag(shift.covariance))[:2]
        text = (
            f"the pictures of {shift.components} components are centred ({x:+.3f}, {y:+.3f}) mm ± ({sx:.3f}, "
            f"{sy:.3f}) from where fiducials and CAD data put them, and turned or stretched{where}: a fiducial is not "
            "at its CAD position, or the centres of the components in the CAD data are not those of the parts"
        )
        return [Reason(ReasonCode.COMPONENTS_SHIFTED, text)]
    used = two_that_place(plane, points)
    errors = [] if used is None else likely_errors(shift, places[used])
    if used is None or not errors or errors[0].mm * px_per_mm <= _LIMIT_PX:
        return []
    each = ", or ".join(f"{names[used[e.which]]} by {e.mm:.2f} mm ({e.mm * px_per_mm:.1f} px)" for e in errors)
    text = (
        f"the pictures of {shift.components} components are centred as if one of the two fiducials were not at its CAD "
        f"position: {each}; check both in the CAD data and on the board; a third fiducial off the line of the two, or "
        "a taught reference, shows which of them is right"
    )
    return [Reason(ReasonCode.COMPONENTS_SHIFTED, text)]
