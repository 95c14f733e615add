"""Views of one component in frames of different exposures, made of a known radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.hdr import Exposed
from vaoi_station.photometry import FieldMaps, NoiseModel, Taken
from vaoi_station.rendering import View

READ, SHOT, DARK = 1.5, 0.03, 2.0
FRAME = (90, 70)
SIZE = (60, 48)
NOISE = NoiseModel(READ, SHOT)


def scene(decades: float = 2.4) -> NDArray[np.float64]:
    """Radiance (h, w) of a board around the component, increasing from left to right, grey levels per µs."""
    ramp = 10 ** np.linspace(-1.4, decades - 1.4, FRAME[0] + 40)
    return np.repeat(ramp[None], FRAME[1] + 40, 0)


def view(camera: int, row: int, shift: tuple[float, float]) -> View:
    """A view that lies at `shift` px in its frame."""
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1.0]])
    unknown = np.full(3, np.nan)
    return View(
        camera, row, *SIZE, 10.0, 1.0, 0.1, np.eye(3), matrix, (), np.zeros((4, 2)), unknown, np.zeros(2), "board", 0.0
    )


def exposed(
    camera: int,
    row: int,
    exposure_us: float,
    *,
    shift: tuple[float, float] = (12.0, 9.0),
    radiance: NDArray[np.float64] | None = None,
    wide: bool = False,
) -> Exposed:
    """A frame whose pixel (x + shift) shows place (x + 20) of the scene, with noise and a flat field that falls off."""
    full = scene() if radiance is None else radiance
    x0, y0 = 20 - int(shift[0]), 20 - int(shift[1])
    flat = np.repeat(np.linspace(1.2, 0.8, FRAME[0])[None], FRAME[1], 0)
    place = np.clip(np.arange(FRAME[0]) + x0, 0, full.shape[1] - 1)
    line = np.clip(np.arange(FRAME[1]) + y0, 0, full.shape[0] - 1)
    signal = full[np.ix_(line, place)] * flat * exposure_us
    rng = np.random.default_rng(100 * camera + row)
    grey = signal + DARK + rng.standard_normal(signal.shape) * np.sqrt(READ**2 + SHOT * signal)
    pixels = np.clip(np.round(grey), 0, 255).astype(np.uint8)
    frame = pixels.astype(np.uint16) * 257 if wide else pixels
    maps = FieldMaps(flat.astype(np.float32), DARK, NOISE)
    return Exposed(view(camera, row, shift), Taken(exposure_us), maps, FRAME, lambda: frame)


def wanted() -> NDArray[np.float64]:
    """The radiance that the picture shows, (h, w)."""
    return scene()[20 : 20 + SIZE[1], 20 : 20 + SIZE[0]]
