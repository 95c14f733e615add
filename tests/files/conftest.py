"""Small valid documents; each test changes one value."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import Recording, write_recording
from vaoi_station.model import RecordingHead


@pytest.fixture
def calibration_document() -> dict[str, Any]:
    """Two cameras side by side, with all optional keys."""
    return {
        "format": "vaoi-calibration",
        "version": 1,
        "unit": "mm",
        "camera_matrices": [
            [[40.0, 0.08, 683.5], [-0.08, 40.0, 528.25], [1e-6, -2e-6, 1.0]],
            [[39.9, -0.1, -628.5], [0.1, 39.9, 449.5], [4e-7, 6e-6, 1.0]],
        ],
        "working_distance_mm": 483.0,
        "residual_px": [0.01, 0.02],
        "principal_point": [[695.5, 519.5], [690.0, 520.0]],
        "created": "2025-01-31T12:00:00Z",
        "covariances": [[1e-6, None]],
        "covariance": [np.diag([0.01] * 8 + [2.25]).tolist(), np.diag([0.02] * 9).tolist()],
        "distortion": [{"center": [695.5, 519.5], "radius": 868.8, "radial": [0.001, -0.0001]}] * 2,
        "x_operator": "night shift",
    }


@pytest.fixture
def board_document() -> dict[str, Any]:
    """A board of 3 × 2 inch with two fiducials and two components, with all optional keys."""
    return {
        "name": "demo",
        "unit": "inch",
        "y_axis": "up",
        "side": "top",
        "outline": [[0.0, 2.0], [3.0, 0.0]],
        "fiducials": [
            {"name": "F1", "x": 0.2, "y": 0.2, "shape": "circle", "diameter": 0.04},
            {"name": "F2", "x": 2.8, "y": 1.8, "shape": "diamond", "diameter": 0.04},
        ],
        "components": [
            {"ref": "U1", "center": [1.0, 1.0], "width": 0.5, "height": 0.25, "rotation": 90.0, "body_height": 0.1},
            {"ref": "U1", "center": [2.0, 1.0], "width": 0.5, "height": 0.25, "rotation": 0.0, "panel": 2},
        ],
        "fixture_mark": {"shape": "cross", "size": 0.08, "width": 0.02, "polarity": "light"},
        "fixture_marks": [{"x": -0.1, "y": 0.5}],
        "x_erp": {"number": 4711},
    }


@pytest.fixture
def recording_document() -> dict[str, Any]:
    """Two small cameras, three rows, one frame missing."""
    return {
        "format": "vaoi-recording",
        "version": 1,
        "cameras": [
            {"width": 24, "height": 16, "exposure_us": 250.0, "nominal_center_mm": [0.0, 0.0], "nominal_px_per_mm": 40},
            {"width": 32, "height": 20, "exposure_us": 100.0},
        ],
        "rows": 3,
        "trigger_period_s": 0.125,
        "conveyor_mm_s": [0.0, 100.0],
        "missing": [[1, 2]],
    }


@pytest.fixture
def recording(tmp_path: Path, recording_document: dict[str, Any]) -> Recording:
    """The recording of that document on disk, with noise as frames."""
    g = np.random.default_rng(3)
    head = RecordingHead.model_validate(recording_document)
    frames = [
        (i, j, g.integers(0, 256, (c.height, c.width), dtype=np.uint8))
        for i, c in enumerate(head.cameras)
        for j in range(head.rows)
        if (i, j) not in head.missing
    ]
    return write_recording(tmp_path / "recording", head, frames)


@pytest.fixture
def write(tmp_path: Path) -> Any:
    """A function that writes a document as JSON text without any check, and returns its path."""

    def write(document: Any, name: str = "document.json") -> Path:
        path = tmp_path / name
        path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
        return path

    return write
