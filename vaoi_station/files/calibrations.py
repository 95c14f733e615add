"""calibration.json."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.model import Calibration


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
    return calibration


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration whole or not at all."""
    write_json(path, calibration.model_dump(mode="json", exclude_none=True))
