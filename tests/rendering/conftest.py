"""A board with a given stitch: cameras, rows, C and a surface are exact."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model import BoardType, Stitch, Surface

Array = NDArray[np.float64]
SIZE = (240, 180)
PX_PER_MM = 8.0


@dataclass(frozen=True)
class Stitched:
    """Everything `views_of` is given."""

    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]

    def raw_px(self, camera: int, row: int, cad: Array, height_mm: float = 0.0) -> Array:
        """Project CAD points into a frame step by step: C, D_j, the pinhole at a height, the lens."""
        assert self.stitch.tester_from_cad is not None
        tester = self.stitch.tester_from_cad(cad)
        d = self.stitch.row_motion[row]
        return self.cameras[camera].project(tester @ d[:2, :2].T + d[:2, 2], height_mm)


def camera(x_mm: float, angle: float, tilt: tuple[float, float], lens: Lens | None, *, y_up: bool) -> Camera:
    c, s = PX_PER_MM * math.cos(angle), PX_PER_MM * math.sin(angle)
    linear = np.array([[c, -s], [s, c]]) @ np.diag([1.0, -1.0 if y_up else 1.0])
    n = np.eye(3)
    n[:2, :2] = linear
    n[:2, 2] = np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]) - linear @ (x_mm, 0.0)
    n = n @ np.array([[1, 0, 0], [0, 1, 0], [*tilt, 1.0]])
    return Camera(
        *SIZE, Projective(n, System.IMAGE, System.ROW), lens or Lens((0.0, 0.0), 1.0), working_distance_mm=200.0
    )


@pytest.fixture(scope="session")
def make() -> Any:
    """Two cameras, four rows 6 mm apart, a board of 40 × 30 mm turned a little; options vary it."""

    def stitched(
        *,
        y_axis: str = "up",
        side: str = "top",
        unit: str = "mm",
        y_up_in_tester: bool = False,
        lens: tuple[float, ...] = (),
        surface: bool = False,
        turn_rad: float = 0.02,
        components: list[dict[str, Any]] | None = None,
    ) -> Stitched:
        k = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}[unit]
        board_type = BoardType.model_validate(
            {
                "name": "b",
                "unit": unit,
                "y_axis": y_axis,
                "side": side,
                "outline": [[0, 0], [40 / k, 30 / k]],
                "components": components
                or [
                    {"ref": f"U{n}", "center": [x / k, y / k], "width": 5 / k, "height": 3 / k}
                    for n, (x, y) in enumerate([(x, y) for x in (5, 15, 25, 35) for y in (4, 15, 26)])
                ],
            }
        )
        bent = Lens(((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2), 150.0, lens) if lens else None
        cameras = (
            camera(-10, 0.01, (1e-5, -2e-5), bent, y_up=y_up_in_tester),
            camera(13, -0.02, (-2e-5, 1e-5), bent, y_up=y_up_in_tester),
        )
        flip = -1.0 if board_type.mirrors != y_up_in_tester else 1.0
        upright = math.pi if side == "bottom" else 0.0
        c, s = k * math.cos(turn_rad + upright), k * math.sin(turn_rad + upright)
        linear = np.array([[c, -s * flip], [s, c * flip]])
        cad = np.eye(3)
        cad[:2, :2], cad[:2, 2] = linear, -linear @ (20 / k, 15 / k)
        motion = []
        for j in range(4):
            a, d = 0.002 * j, np.eye(3)
            d[:2] = [[math.cos(a), -math.sin(a), 0.1 * j], [math.sin(a), math.cos(a), 6.0 * j - 9]]
            motion.append(d)
        matrices = tuple(tuple(cam.image_from_row.matrix @ d for d in motion) for cam in cameras)
        bump = Surface(
            lift_mm=0.6,
            tilt_mm=(0.1, -0.1),
            bow_mm=(-0.4, 0.05, -0.3),
            about=(20 / k, 15 / k),
            half_span=(20 / k, 15 / k),
        )
        stitch = Stitch(
            method="auto",
            image_matrices=matrices,
            cad_matrix=cad,
            row_motion=tuple(motion),
            status="ok",
            surface=bump if surface else None,
        )
        return Stitched(board_type, stitch, cameras)

    return stitched
