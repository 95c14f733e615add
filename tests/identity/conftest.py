"""Passages of small boards with codes, and their results from the truth, so that no run is stitched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.simulation import Scenario, Twin

DATAMATRIX = {"x_mm": 9.0, "y_mm": 8.0, "module_mm": 0.25, "turned_deg": 30.0}
QR = {"x_mm": 23.0, "y_mm": 12.0, "module_mm": 0.25, "symbology": "qr", "inverted": True}


@dataclass(frozen=True)
class Filmed:
    """A run with its frames."""

    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    frames: dict[tuple[int, int], NDArray[Any]]
    texts: tuple[str, ...]

    def frame(self, camera: int, row: int) -> NDArray[Any] | None:
        return self.frames.get((camera, row))

    def with_identity(self, **changes: Any) -> BoardType:
        assert self.board_type.identity is not None
        identity = self.board_type.identity.model_copy(update=changes)
        return self.board_type.model_copy(update={"identity": identity})


def film(codes: tuple[dict[str, Any], ...], **board: Any) -> Filmed:
    scenario = {
        "array": {
            "cameras": 2, "width_px": 320, "height_px": 240, "px_per_mm": 20.0, "working_distance_mm": 250.0,
        },
        "board": {
            "name": "coded", "width_mm": 32.0, "length_mm": 20.0, "density": 0.0, "codes": codes, **board,
        },
        "line": {"barrier_mm": -15.0, "start_delay_s": 0.1, "period_s": 0.04, "tail_s": 0.12},
    }  # fmt: skip
    passage = Twin(Scenario.model_validate(scenario)).passage(6)
    truth, twin = passage.truth(), passage.twin
    stitch = Stitch(
        method="auto",
        image_matrices=truth["image_matrices"],
        cad_matrix=np.array(truth["cad_matrix"]),
        row_motion=truth["row_motion"],
        status=Status.OK,
    )
    return Filmed(twin.board_type, stitch, twin.cameras, passage.render_all(), passage.code_texts)


@pytest.fixture(scope="session")
def make_coded() -> Callable[..., Filmed]:
    """A function that films a small board with codes."""
    return film


@pytest.fixture(scope="session")
def coded() -> Filmed:
    """Two codes on the bottom of a board whose CAD data are in mil."""
    return film((DATAMATRIX, QR), side="bottom", unit="mil")
