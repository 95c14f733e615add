"""One camera of an array in the place of another: its calibration until it is known, and from a calibration board."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from vaoi_station.calibration.calibration_difference import compare_calibrations
from vaoi_station.errors import InputError
from vaoi_station.geometry.camera_error import FIELDS, PLACE_FIELDS
from vaoi_station.model import Calibration, CameraHead

PLACE_PX, SHAPE_PX = 60.0, 0.1
"""Standard deviations after an exchange, px: of shift and turn, and at the corner of scale and perspective.

Sensors lie in their housings, and housings in their mounts, to a few tenths of a mm and of a degree. Boards show shift
and turn only; a lens that was focused anew may change the scale by more: that leaves residuals (`drift.recalibrate`).
"""
_SHAPE = (3, 6, 7)
"""Fields of the second value. Distortion and pixels of the same lens and model stay."""
HELD_PX = 0.1
"""Largest accepted rms difference of the other cameras between the calibration in force and a new one, px."""


def without_place(calibration: Calibration, camera: int) -> Calibration:
    """Return a calibration that does not know any more where a camera hangs. The others stay as they are."""
    count = len(calibration.camera_matrices)
    known = list(calibration.covariance or [np.zeros((FIELDS, FIELDS))] * count)
    # What was known of the place of the predecessor has no value; its lens stays.
    vague = np.array(known[camera])
    vague[:PLACE_FIELDS], vague[:, :PLACE_FIELDS] = 0.0, 0.0
    added = np.zeros(FIELDS)
    added[:PLACE_FIELDS], added[list(_SHAPE)] = PLACE_PX**2, SHAPE_PX**2
    known[camera] = vague + np.diag(added)
    return _changed(calibration, covariance=tuple(known))


def with_camera(
    calibration: Calibration, made: Calibration, heads: Sequence[CameraHead], camera: int
) -> tuple[Calibration, float]:
    """Return a calibration with one camera of another, made with the array as it hangs now; all others are held.

    The new calibration has the board where it lay: the motion that takes its other cameras to those in force is
    removed. Also returned is the rms difference of the other cameras after that, px.

    Raises:
        InputError: there is no other camera, or the others differ by more than `HELD_PX`.
    """
    others = [i for i in range(len(heads)) if i != camera]
    if not others:
        raise InputError(
            "An array of one camera has no neighbour that could be held.",
            action="Calibrate the whole array.",
            code="too-little-evidence",
        )
    difference = compare_calibrations(made, calibration, heads, only=others)
    worst = max(others, key=lambda i: float(difference.rms_px[i]))
    rms_px = float(difference.rms_px[worst])
    if rms_px > HELD_PX:
        raise InputError(
            f"Camera {worst}, which is to be held, differs by {rms_px:.2f} px from the calibration in force (limit "
            f"{HELD_PX}): it hangs elsewhere too, or the board is not the one of that calibration.",
            action="Accept a calibration of the whole array.",
            code="neighbours-moved",
        )
    changes: dict[str, object] = {}
    matrices = list(calibration.camera_matrices)
    matrix = made.camera_matrices[camera] @ difference.this_from_other
    matrices[camera] = matrix / matrix[2, 2]
    if calibration.covariance is not None or made.covariance is not None:
        unknown = [np.zeros((FIELDS, FIELDS))] * len(heads)
        known = list(calibration.covariance or unknown)
        known[camera] = (made.covariance or unknown)[camera]
        changes["covariance"] = tuple(known)
    for key in ("residual_px", "principal_point", "covariances", "distortion"):
        ours, theirs = getattr(calibration, key), getattr(made, key)
        if ours is not None and theirs is not None:
            changes[key] = type(ours)((*ours[:camera], theirs[camera], *ours[camera + 1 :]))
    return _changed(calibration, camera_matrices=tuple(matrices), **changes), rms_px


def _changed(calibration: Calibration, **changes: object) -> Calibration:
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return calibration.model_copy(update={**changes, "created": created})
