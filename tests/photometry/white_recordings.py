"""Small recordings of white targets, of darkness and of boards, with known flat fields."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files import Recording, write_recording
from vaoi_station.model import RecordingHead

WIDTH, HEIGHT = 128, 96
DARK, READ, SHOT = 3.0, 1.5, 0.03
EXPOSURE_US = 250.0
Scene = Callable[[int, int], NDArray[Any]]
"""Radiance (h, w) by camera and row, in grey levels per µs."""


def shade(camera: int, light: str | None = None, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.float64]:
    """The flat field of a camera: vignetting off the centre, and a lamp that falls off to one side."""
    x, y = np.meshgrid(np.linspace(-1, 1, size[0]), np.linspace(-1, 1, size[1]))
    lamp = {"left": 1 - 0.3 * x, "right": 0.8 + 0.2 * x}.get(light or "", np.ones_like(x))
    return np.asarray((1 - 0.2 * ((x - 0.2 * camera) ** 2 + y**2)) * lamp * (1 + 0.1 * camera))


def white(level: float) -> Scene:
    """A white target: one radiance all over."""
    return lambda _camera, _row: np.full((1, 1), level / EXPOSURE_US)


def film(
    directory: Path,
    scene: Scene,
    *,
    lights: Sequence[str] = (),
    rows: int = 4,
    cameras: int = 2,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    **head: Any,
) -> Recording:
    """Write a recording of a scene; `lights` are used in turn."""
    names = [lights[row % len(lights)] for row in range(rows)] if lights else None
    data = {
        "format": "vaoi-recording",
        "version": 1,
        "cameras": [{"width": size[0], "height": size[1], "exposure_us": EXPOSURE_US}] * cameras,
        "rows": rows,
        "trigger_period_s": 0.1,
        "conveyor_mm_s": [0, 100],
    }
    if names:
        data["lights"] = names
    made = RecordingHead.model_validate(data | head)
    rng = np.random.default_rng(rows)
    frames = []
    for camera in range(cameras):
        for row in range(rows):
            if (camera, row) in made.missing:
                continue
            scale = made.exposure_us(camera, row) * made.gain(camera, row)
            signal = scene(camera, row) * shade(camera, made.light(row), size) * scale
            noise = rng.standard_normal(signal.shape) * np.sqrt(READ**2 + SHOT * signal)
            frames.append((camera, row, np.clip(np.round(signal + DARK + noise), 0, 255).astype(np.uint8)))
    return write_recording(directory, made, frames)
