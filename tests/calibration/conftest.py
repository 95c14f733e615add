from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration import Limits, Outcome, calibrate
from vaoi_station.calibration.artwork import ArrayDesign, design_board
from vaoi_station.files.calibrations import Layout
from vaoi_station.geometry import Lens
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Calibration, CameraHead

Frame = NDArray[np.uint8]
Change = Callable[[int, Frame], Frame]
WIDTH, HEIGHT, PX_PER_MM = 480, 360, 20.0
FIELD = WIDTH / PX_PER_MM, HEIGHT / PX_PER_MM
_FINE = 3


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras slightly off their design, and their frames of a board from an independent ray tracer."""

    layout: Layout
    heads: tuple[CameraHead, ...]
    matrices: tuple[Floats, ...]
    lenses: tuple[Lens, ...]
    frames: tuple[Frame, ...]

    def calibrate(self, layout: Layout | None = None, change: Change | None = None, **limits: Any) -> Outcome:
        """Calibrate it, perhaps by another layout or from changed frames."""

        def frame(i: int) -> Frame:
            return change(i, self.frames[i].copy()) if change else self.frames[i]

        return calibrate(self.heads, frame, layout or self.layout, Limits(**limits))

    def errors_px(self, calibration: Calibration) -> list[float]:
        """rms over each frame of where raw pixels lie by the calibration and in truth."""
        x, y = np.linspace(0, WIDTH - 1, 9), np.linspace(0, HEIGHT - 1, 9)
        grid, out = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2), []
        for camera, n, lens in zip(calibration.cameras(self.heads), self.matrices, self.lenses, strict=True):
            off = apply(n, camera.ground(grid)) - lens.undistort(grid)
            out.append(float(np.sqrt((off**2).sum(1).mean())))
        return out

    def seen_at(self, camera: int, mark: int) -> Floats:
        """Raw pixels of a mark of the layout."""
        m = self.layout.marks[mark]
        return self.lenses[camera].distort(apply(self.matrices[camera], (m.x, m.y)))

    def in_view(self, camera: int) -> list[int]:
        """Marks that lie well inside a frame."""
        at = [self.seen_at(camera, k) for k in range(len(self.layout.marks))]
        return [k for k, (x, y) in enumerate(at) if 22 < x < WIDTH - 23 and 22 < y < HEIGHT - 23]


Film = Callable[..., Rig]


def _matrix(g: np.random.Generator, x: float, shift_mm: Sequence[float], tilt: float, roll: float) -> Floats:
    """N of a pinhole camera 300 mm above (x, 0), tilted, turned and shifted."""
    d, f = 300.0, 300.0 * PX_PER_MM * (1 + g.normal(0, 0.002))
    ax, ay = g.normal(0, tilt, 2)
    c, s = math.cos(roll), math.sin(roll)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ cv2.Rodrigues(np.array([ax, ay, 0.0]))[0]
    base = np.diag([1.0, 1.0, -1.0])
    place = np.array([x + shift_mm[0], shift_mm[1], d])
    inner = np.array([[f, 0, (WIDTH - 1) / 2], [0, f, (HEIGHT - 1) / 2], [0, 0, 1.0]])
    p = inner @ turn @ np.hstack([base, -(base @ place)[:, None]])
    n = p[:, [0, 1, 3]]
    return np.asarray(n / n[2, 2])


def _picture(layout: Layout, n: Floats, lens: Lens, g: np.random.Generator, noise: float, vignette: float) -> Frame:
    """Rays through three by three points of every pixel meet the board; coverage is exact to a hundredth."""
    w, h = WIDTH * _FINE, HEIGHT * _FINE
    x, y = (np.arange(w) + 0.5) / _FINE - 0.5, (np.arange(h) + 0.5) / _FINE - 0.5
    raw = np.stack(np.meshgrid(x, y), -1)
    ground = apply(np.linalg.inv(n), lens.undistort(raw)) / layout.mm_per_unit
    fine = PX_PER_MM * _FINE * layout.mm_per_unit
    covered = np.zeros((h, w), np.float32)
    r, a = layout.mark.size / 2, layout.mark.width / 2
    for m in layout.marks:
        u, v = lens.distort(apply(n, np.array([m.x, m.y]) * layout.mm_per_unit)) * _FINE
        reach = int(r * fine * 1.3) + 4
        s = np.s_[max(int(v) - reach, 0) : max(int(v) + reach, 0), max(int(u) - reach, 0) : max(int(u) + reach, 0)]
        q = np.abs(ground[s] - (m.x, m.y))
        if not q.size:
            continue
        d = np.minimum(np.maximum(q[..., 0] - r, q[..., 1] - a), np.maximum(q[..., 0] - a, q[..., 1] - r))
        covered[s] = np.maximum(covered[s], np.clip(0.5 - d * fine, 0, 1))
    paper, ink = (205.0, 25.0) if layout.mark.polarity == "dark" else (25.0, 205.0)
    image = cv2.resize(paper + (ink - paper) * covered, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    far = np.linspace(-1, 1, WIDTH)[None] ** 2 + np.linspace(-1.1, 0.9, HEIGHT)[:, None] ** 2
    image = image * (1 - vignette * far / 2)
    image = image + g.standard_normal(image.shape) * np.sqrt(0.03 * image + 1.5**2) * noise
    return np.asarray(np.clip(np.rint(image + 2), 0, 255), dtype=np.uint8)


@pytest.fixture(scope="session")
def film() -> Film:
    """Film a board: by default our own artwork for two cameras, with noise and vignetting."""

    def film(
        seed: int = 1,
        *,
        layout: Layout | None = None,
        cameras: int = 2,
        shift_mm: float = 0.5,
        roll_deg: float = 0.5,
        distortion_px: float = 0.0,
        noise: float = 1.0,
        vignette: float = 0.25,
    ) -> Rig:
        g = np.random.default_rng(seed)
        pitch = 0.95 * FIELD[0]
        if layout is None:
            layout = design_board(
                ArrayDesign(cameras, pitch, FIELD, columns=5, rows=4, mark_mm=1.2, tolerance_mm=1.5)
            ).layout
        heads = tuple(
            CameraHead(
                width=WIDTH,
                height=HEIGHT,
                exposure_us=250.0,
                nominal_center_mm=(i * pitch, 0.0),
                nominal_px_per_mm=PX_PER_MM,
            )
            for i in range(cameras)
        )
        matrices, lenses, frames = [], [], []
        for i in range(cameras):
            roll = math.radians(g.normal(0, roll_deg))
            matrices.append(_matrix(g, i * pitch, g.normal(0, shift_mm, 2).tolist(), 0.002, roll))
            radius = math.hypot(WIDTH, HEIGHT) / 2
            radial = (-distortion_px / radius,) if distortion_px else ()
            lenses.append(Lens(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), radius, radial))
            frames.append(_picture(layout, matrices[i], lenses[i], g, noise, vignette))
        return Rig(layout, heads, tuple(matrices), tuple(lenses), tuple(frames))

    return film


@pytest.fixture(scope="session")
def rig(film: Film) -> Rig:
    """Two cameras over our own artwork; to read."""
    return film()
