"""Read and write single documents. A path is a `Path` or a text. A wrong argument raises an `InputError`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station import files
from vaoi_station.errors import InputError
from vaoi_station.files import images
from vaoi_station.library.arguments import require_instance, require_path
from vaoi_station.model import BoardType, Calibration, Stitch


def read_calibration(path: str | Path) -> Calibration:
    """Read calibration.json: camera matrices N_i and lenses."""
    return files.read_calibration(require_path("read_calibration", "path", path))


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write calibration.json atomically: the file is complete or unchanged."""
    require_instance("write_calibration", "calibration", calibration, Calibration)
    files.write_calibration(require_path("write_calibration", "path", path), calibration)


def read_board_type(path: str | Path) -> BoardType:
    """Read board.json: outline, fiducials and components of a board type."""
    return files.read_board_type(require_path("read_board_type", "path", path))


def write_board_type(path: str | Path, board_type: BoardType) -> None:
    """Write board.json atomically: the file is complete or unchanged."""
    require_instance("write_board_type", "board_type", board_type, BoardType)
    files.write_board_type(require_path("write_board_type", "path", path), board_type)


def read_result(path: str | Path) -> Stitch:
    """Read the result of a stitch, as `vaoi stitch` or `GET runs/{id}/matrices` gives it."""
    return files.read_stitch(require_path("read_result", "path", path))


def read_image(path: str | Path) -> NDArray[Any]:
    """Read a PNG or TIFF, (height, width) or (height, width, 3) blue-green-red, 8 or 16 bit."""
    return images.read_image(require_path("read_image", "path", path))


def write_image(path: str | Path, pixels: NDArray[Any]) -> None:
    """Write a PNG, or an uncompressed TIFF if the path ends in .tiff or .tif, atomically. Create missing folders."""
    target = require_path("write_image", "path", path)
    if target.suffix not in (".png", ".tif", ".tiff"):
        raise InputError.field("write_image", "path", str(target), "a name that ends in .png, .tif or .tiff")
    try:
        array = np.ascontiguousarray(pixels)  # callers pass slices of frames
    except ValueError as error:  # nested lists of different lengths
        raise InputError.field("write_image", "pixels", pixels, "an array of pixels") from error
    is_image = array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)
    # The encoder would scale, clip or drop values of any other kind without an error.
    if array.dtype not in (np.uint8, np.uint16) or not is_image or not array.size:
        raise InputError(
            f"{target}: the pixels have shape {array.shape} and type {array.dtype}, but must be (height, width) or "
            "(height, width, 3) of uint8 or uint16.",
            action="Convert them first.",
        )
    images.write_image(target, array)
