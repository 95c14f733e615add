"""Exact pictures: textures that are formulas, rendered at any point without interpolation, and cameras above them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model import BoardType, Calibration, RecordingHead, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.work import StitchSetup, all_tasks, stitch_frames

Array = NDArray[np.float64]


class Waves:
    """A band-limited texture: sinusoids of random direction, none finer than `finest` periods."""

    def __init__(self, seed: int = 0, finest: float = 5.0, coarsest: float = 60.0, count: int = 90) -> None:
        g = np.random.default_rng(seed)
        direction = g.uniform(0, 2 * math.pi, count)
        frequency = np.exp(g.uniform(math.log(1 / coarsest), math.log(1 / finest), count))
        self._fx, self._fy = frequency * np.cos(direction), frequency * np.sin(direction)
        self._phase = g.uniform(0, 2 * math.pi, count)
        self._height = 30.0 * math.sqrt(2 / count)

    def __call__(self, x: Array, y: Array) -> Array:
        """Grey levels about 128, standard deviation 30."""
        out = np.full(np.broadcast(x, y).shape, 128.0)
        for fx, fy, phase in zip(self._fx, self._fy, self._phase, strict=True):
            out += self._height * np.cos(2 * math.pi * (fx * x + fy * y) + phase)
        return out

    def picture(self, width: int, height: int, shift: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.uint8]:
        """Render with the origin at pixel `shift`."""
        return digitised(self.levels(width, height, shift))

    def levels(self, width: int, height: int, shift: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Return the grey levels before rounding."""
        return self._affine(width, height, np.array([[1.0, 0.0, -shift[0]], [0.0, 1.0, -shift[1]]]))

    def _affine(self, width: int, height: int, texture_from_pixel: Array) -> Array:
        """Return the grey levels for an affine map (2, 3); cos(a + b) is a product, for speed."""
        fx, fy, start = (np.stack([self._fx, self._fy], -1) @ texture_from_pixel).T
        across = np.exp(2j * math.pi * fx[:, None] * np.arange(width))
        down = np.exp(1j * (2 * math.pi * (fy[:, None] * np.arange(height) + start[:, None]) + self._phase[:, None]))
        return np.asarray(128 + self._height * (down.T @ across).real)

    def seen_by(self, camera: Camera, place: Callable[[Array], Array]) -> NDArray[np.uint8]:
        """Render what a camera sees, given the texture coordinates of points (k, 2) of the conveyor's plane."""
        y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float64)
        at = place(camera.ground(np.stack([x.ravel(), y.ravel()], -1)))
        first, right, down = at[0], at[1], at[camera.width_px]
        affine = np.stack([right - first, down - first, first], -1)
        if np.allclose(np.stack([x.ravel(), y.ravel(), np.ones(x.size)], -1) @ affine.T, at, rtol=0, atol=1e-9):
            return digitised(self._affine(camera.width_px, camera.height_px, affine))
        return digitised(self(at[:, 0], at[:, 1]).reshape(x.shape))


def digitised(grey: Array) -> NDArray[np.uint8]:
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)


@dataclass(frozen=True)
class Workshop:
    """Builders of scenes for tests."""

    waves: type[Waves] = Waves

    @staticmethod
    def digitised(grey: Array) -> NDArray[np.uint8]:
        """Round to whole numbers 0 … 255, as a camera does."""
        return digitised(grey)

    @staticmethod
    def camera(
        center_mm: tuple[float, float] = (0.0, 0.0),
        *,
        size_px: tuple[int, int] = (200, 160),
        px_per_mm: float = 10.0,
        angle_rad: float = 0.0,
        tilt: tuple[float, float] = (0.0, 0.0),
        distance_mm: float | None = None,
        y_up: bool = False,
        lens: Lens | None = None,
    ) -> Camera:
        """Build a camera whose centre sees `center_mm`; `y_up`: the tester's y runs up the image."""
        c, s = px_per_mm * math.cos(angle_rad), px_per_mm * math.sin(angle_rad)
        linear = np.array([[c, -s], [s, c]]) @ np.diag([1.0, -1.0 if y_up else 1.0])
        n = np.eye(3)
        n[:2, :2] = linear
        n[:2, 2] = np.array([(size_px[0] - 1) / 2, (size_px[1] - 1) / 2]) - linear @ np.array(center_mm)
        n = n @ np.array([[1, 0, 0], [0, 1, 0], [*tilt, 1 - tilt[0] * center_mm[0] - tilt[1] * center_mm[1]]])
        return Camera(
            *size_px,
            image_from_row=Projective(n, System.IMAGE, System.ROW),
            lens=lens or Lens((0.0, 0.0), 1.0),
            working_distance_mm=distance_mm,
        )


@pytest.fixture(scope="session")
def workshop() -> Any:
    return Workshop()


@dataclass(frozen=True)
class Filmed:
    """A board of the digital twin with its frames in memory, and its result."""

    head: RecordingHead
    calibration: Calibration
    setup: StitchSetup
    frames: dict[tuple[int, int], NDArray[Any]]
    truth: dict[str, Any]

    @property
    def board_type(self) -> BoardType:
        assert self.setup.board_type is not None
        return self.setup.board_type

    @property
    def present(self) -> list[tuple[int, int]]:
        return sorted(self.frames)

    @property
    def times_s(self) -> Array:
        return self.head.row_times_s()

    @property
    def tasks(self) -> tuple[Task, ...]:
        return all_tasks(self.present, dict(enumerate(self.times_s)), self.setup)

    def frame(self, camera: int, row: int) -> NDArray[Any] | None:
        return self.frames.get((camera, row))

    @cached_property
    def stitch(self) -> Stitch:
        """The result with the true set-up and all frames."""
        return self.stitched()

    def stitched(
        self,
        *,
        board_type: BoardType | None = None,
        calibration: Calibration | None = None,
        frames: dict[tuple[int, int], NDArray[Any]] | None = None,
        expectation: Expectation | None = None,
    ) -> Stitch:
        """Stitch with a changed board type, calibration, set of frames or expectation."""
        setup = replace(
            self.setup,
            board_type=board_type or self.setup.board_type,
            cameras=(calibration or self.calibration).cameras(self.head.cameras),
            expectation=expectation or self.setup.expectation,
        )
        there = self.frames if frames is None else frames
        missing = tuple(key for key in self.frames if key not in there)
        head = self.head.model_copy(update={"missing": missing})
        return stitch_frames(setup, head, lambda i, j: there.get((i, j)))

    def error_px(self, stitch: Stitch) -> float:
        """Return the largest error of a component in any view, against the twin's truth."""
        assert stitch.components is not None
        ours = {(ref, i, j): (x, y) for ref, views in stitch.components.items() for i, j, x, y in views}
        off = [
            math.hypot(ours[ref, i, j][0] - x, ours[ref, i, j][1] - y)
            for ref, views in self.truth["views"].items()
            for i, j, x, y in views
            if stitch.image_matrices[i][j] is not None
        ]
        return max(off)


@pytest.fixture(scope="session")
def filmed() -> Filmed:
    twin = Twin(read_scenario(scenario_path("small")))
    passage = twin.passage(0)
    head = passage.head()
    setup = StitchSetup(
        twin.calibration.cameras(head.cameras), head.conveyor_mm_s, head.trigger_period_s, twin.board_type
    )
    return Filmed(head, twin.calibration, setup, passage.render_all(), passage.truth())
