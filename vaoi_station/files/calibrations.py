"""calibration.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.geometry import Projective, System
from vaoi_station.model import Calibration

_LEAST_PX_PER_MM, _MOST_PX_PER_MM = 0.05, 5000.0
_MOST_APART = 4.0
"""Cameras of one array differ in resolution by no greater factor."""


def read_calibration(path: Path, cameras: int | None = None) -> Calibration:
    """Read a calibration; refuse it if it is for another number of cameras."""
    data = read_json(path)
    check_format(data, path, "vaoi-calibration", 1)
    calibration = parse(Calibration, data, path)
    found = len(calibration.camera_matrices)
    if cameras is not None and found != cameras:
        raise InputError(
            f"{path}: camera_matrices has {found} entries, but {cameras} cameras were filming.",
            action="Use the calibration of this array.",
        )
    _check_views(calibration, path)
    return calibration


def _check_views(calibration: Calibration, path: Path) -> None:
    """Refuse matrices that no camera of one array has: a resolution out of all proportion, or one camera mirrored."""
    views = [Projective(matrix, System.IMAGE, System.ROW) for matrix in calibration.camera_matrices]
    scales = [view.scale_at(view.inverse()((0.0, 0.0))) for view in views]
    usual, mirrored = float(np.median(scales)), [view.mirrors for view in views]
    for i, scale in enumerate(scales):
        if not _LEAST_PX_PER_MM <= scale <= _MOST_PX_PER_MM:
            limit = f"between {_LEAST_PX_PER_MM:g} and {_MOST_PX_PER_MM:g} px/mm"
        elif not 1 / _MOST_APART <= scale / usual <= _MOST_APART:
            limit = f"within a factor of {_MOST_APART:g} of the array's median, {usual:.4g} px/mm"
        else:
            continue
        raise InputError(
            f"{path}: camera_matrices.{i} gives camera {i} a resolution of {scale:.4g} px/mm, but it must be {limit}.",
            action="Calibrate again, or use the calibration of this array.",
        )
    if len(set(mirrored)) > 1:
        odd = mirrored.index(sum(mirrored) * 2 <= len(mirrored))
        raise InputError(
            f"{path}: camera_matrices.{odd} has a determinant of the other sign than most: camera {odd} "
            f"{'mirrors' if mirrored[odd] else 'does not mirror'} the board, but cameras of one array see it alike.",
            action="Calibrate again with one layout for all cameras.",
        )


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration whole or not at all."""
    write_json(path, calibration.model_dump(mode="json", exclude_none=True))
