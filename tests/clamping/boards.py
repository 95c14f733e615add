"""A board as a run has filmed it, and a tester that clamps it: turned, shifted, bent otherwise. The truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.clamping import ClampedRequest, FilmedBoard, Reading
from vaoi_station.geometry.transforms import Floats, Similarity, System
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.model.board_type import Fiducial

FIDUCIALS = {"F1": (5.0, 5.0), "F2": (152.0, 8.0), "F3": (148.0, 95.0), "F4": (9.0, 91.0), "F5": (60.0, 52.0)}
THICKNESS_MM = 1.6


def board_type(**fields: object) -> BoardType:
    """Return a board of 160 × 100 mm; `fields` replace those of the board type."""
    places = [(x, y) for x in (20.0, 80.0, 140.0) for y in (20.0, 50.0, 80.0)]
    parts = [Component(ref=f"U{n}", center=at, width=8.0, height=4.0, rotation=30.0 * n) for n, at in enumerate(places)]
    marks = tuple(Fiducial(name=name, x=x, y=y, diameter=1.0) for name, (x, y) in FIDUCIALS.items())
    known = {"name": "b", "outline": ((0.0, 0.0), (160.0, 100.0)), "fiducials": marks, "components": tuple(parts)}
    return BoardType.model_validate({**known, **fields})


def filmed(board: BoardType | None = None, **fields: object) -> FilmedBoard:
    """Return it as filmed: turned by 3°, at (12, 40) mm, the tester's y down; `fields` replace those of the result."""
    board = board or board_type()
    # The tester's coordinates of the film are left-handed as the filmed side is seen, CAD ones by side and y axis.
    matrix = Similarity.of(
        board.mm_per_unit, 0.05, (12.0, 40.0), System.TESTER, System.CAD, mirrored=board.mirrors
    ).matrix
    seen = [{"name": f.name, "sightings": 9, "residual_px": (0.0, 0.0)} for f in board.fiducials]
    bodies = {"heights_mm": {"U0": 3.0}, "height_sigma_mm": {"U0": 0.05}}
    known = {"method": "auto", "image_matrices": (), "row_motion": (), "cad_matrix": matrix, "status": "ok"}
    known["quality"] = {"fiducials": seen, "cad_sigma_px": 0.04, "surface_sigma_mm": 0.02, **bodies}
    known["surface"] = {"lift_mm": 0.3, "about": (80.0, 50.0), "half_span": (80.0, 50.0)}
    return FilmedBoard(board, Stitch.model_validate({**known, **fields}), 20.0)


@dataclass(frozen=True, eq=False)
class Clamp:
    """The truth of a clamped board: millimetres, y up."""

    turn_rad: float = 0.7
    shift_mm: tuple[float, float] = (210.0, -85.0)
    strain: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plane_mm: tuple[float, float, float] = (2.0, 0.1, -0.2)
    bow_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __call__(self, cad: Floats) -> Floats:
        """Return where points (k, 2) are, (k, 3)."""
        u, v = ((np.asarray(cad) - (80.0, 50.0)) / (80.0, 50.0)).T
        (a, b, c), (d, e, f) = self.plane_mm, self.bow_mm
        slope = np.stack([(2 * d * u + e * v) / 80.0, (e * u + 2 * f * v) / 50.0], 1)
        scale, stretch, shear = self.strain
        turn = np.array(
            [[np.cos(self.turn_rad), -np.sin(self.turn_rad)], [np.sin(self.turn_rad), np.cos(self.turn_rad)]]
        )
        shape = np.eye(2) + np.array([[scale + stretch, shear], [shear, scale - stretch]])
        flat = (np.asarray(cad) - THICKNESS_MM / 2 * slope) @ (turn @ shape).T + self.shift_mm
        return np.column_stack([flat, a + b * u + c * v + d * u * u + e * u * v + f * v * v])

    def readings(self, *names: str, z: bool = False, noise: Floats | None = None) -> tuple[Reading, ...]:
        """Return readings of fiducials, with noise (k, 3)."""
        at = self(np.array([FIDUCIALS[name] for name in names])) + (0.0 if noise is None else noise)
        return tuple(
            Reading(fiducial=name, x=x, y=y, z=h if z else None)
            for name, (x, y, h) in zip(names, at.tolist(), strict=True)
        )


def request(readings: tuple[Reading, ...], **fields: object) -> ClampedRequest:
    """Return a request of a tester with a σ of 10 µm."""
    return ClampedRequest.model_validate({"readings": readings, "sigma": 0.01, **fields})
