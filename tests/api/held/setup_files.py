"""The files of a held station, and frames in which its cameras see a calibration board."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.api.held.programs import CONFIG
from tests.api.held_station import CAMERAS, HEIGHT, PX_PER_MM, WIDTH, HeldStation
from vaoi_station.api.setup.calibration import ArtworkOptions
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import read_config
from vaoi_station.files import write_calibration
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import Calibration

PITCH_MM = 36.0
FINE = 4
OPTIONS = ArtworkOptions(mark_mm=2.0, tolerance_mm=1.5)
CAMERA = """
[[cameras]]
name = "cam{n}"
width = {width}
height = {height}
exposure_us = 250.0
"""


NOMINAL = """nominal_center_mm = [{x}, 0.0]
nominal_px_per_mm = {px}
"""


def setup_files(folder: Path, nominal: bool = True) -> StationFiles:
    """Write station.toml, with or without nominal views of the cameras, and the calibration in force, as designed."""
    camera = CAMERA + (NOMINAL if nominal else "")
    cameras = (camera.format(n=n, width=WIDTH, height=HEIGHT, x=n * PITCH_MM, px=PX_PER_MM) for n in range(CAMERAS))
    path = folder / "station.toml"
    path.write_text(CONFIG + "".join(cameras))
    config = read_config(path)
    matrices = tuple(_matrix(n) for n in range(CAMERAS))
    made = Calibration(format="vaoi-calibration", version=1, unit="mm", camera_matrices=matrices)
    write_calibration(config.calibration, made)
    return StationFiles(path.resolve(), config)


def film_board(station: HeldStation, layout: Layout, shift_mm: float = 0.4) -> str:
    """A run whose frames of row 0 show the board, displaced along the array."""
    run = station.film(board_id="calibration")
    for camera in range(CAMERAS):
        station.pixels[run, camera, 0] = _picture(layout, _matrix(camera), shift_mm)
    return run


def _matrix(camera: int) -> Any:
    x, y = (WIDTH - 1) / 2 - PX_PER_MM * camera * PITCH_MM, (HEIGHT - 1) / 2
    return np.array([[PX_PER_MM, 0, x], [0, PX_PER_MM, y], [0, 0, 1.0]])


def _picture(layout: Layout, matrix: Any, shift_mm: float) -> Any:
    image = np.full((HEIGHT * FINE, WIDTH * FINE), 205, np.uint8)
    r, a = layout.mark.size / 2, layout.mark.width / 2
    for mark in layout.marks:
        for u, v in ((r, a), (a, r)):
            corners = np.array([(-u, -v), (u, -v), (u, v), (-u, v)]) + (mark.x + shift_mm, mark.y)
            px = (corners @ matrix[:2, :2].T + matrix[:2, 2] + 0.5) * FINE - 0.5
            cv2.fillPoly(image, [np.rint(px * 16).astype(np.int32)], 25, cv2.LINE_AA, 4)
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0, 1.5, small.shape)
    return np.clip(cv2.GaussianBlur(small, (0, 0), 0.6) + noise, 0, 255).astype(np.uint8)
