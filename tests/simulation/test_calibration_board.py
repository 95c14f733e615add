from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vaoi_station.simulation import Twin
from vaoi_station.simulation.calibration_board import (
    layout,
    mark_places_mm,
    write_calibration_recording,
)

Make = Callable[..., Twin]


def test_every_camera_sees_its_crosses_where_the_truth_puts_them(make: Make, tmp_path: Path) -> None:
    twin = make(
        array={"cameras": 2, "width_px": 400, "height_px": 300, "px_per_mm": 12.0, "distortion_px": 0.7},
        calibration_board={"marks_per_axis": 3},
    )
    recording = write_calibration_recording(twin, tmp_path)
    assert json.loads((tmp_path / "layout.json").read_text()) == layout(twin)
    assert len(json.loads((tmp_path / "truth.json").read_text())["distortion"][0]["radial"]) == 1
    y, x = np.mgrid[-14:15, -14:15]
    for i, pinhole in enumerate(twin.pinholes):
        frame = recording.frame(i, 0)
        assert frame is not None
        pixels = pinhole.project(mark_places_mm(twin), 0.0)
        seen = pixels[((pixels > 20) & (pixels < [379, 279])).all(1)]
        assert len(seen) >= 9
        for u, v in seen:
            a, b = round(u), round(v)
            weight = 205.0 - frame[b - 14 : b + 15, a - 14 : a + 15]
            centre = np.array([a, b]) + np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
            assert np.abs(centre - (u, v)).max() < 0.03
