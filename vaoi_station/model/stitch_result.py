"""A stitch: the image matrices of all frames of a run, their quality, the verdict, and heights of components."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from vaoi_station.geometry import Camera, Projective, System, apply
from vaoi_station.model.board_type import BoardType, Component
from vaoi_station.model.frozen_model import FrozenModel, Matrix, Millimetres, Pixels, Point, PointMm, Positive, Whole

_HalfSpan = Annotated[Positive, Field(ge=1e-6)]


class Status(StrEnum):
    """The verdict on the result of stitching a run."""

    OK = "ok"
    DEGRADED = "degraded"
    FAILED = "failed"


class Surface(FrozenModel):
    """The height of the board's surface above the calibrated plane in mm: a polynomial of second degree.

    Its variables are u, v = (CAD point − `about`) / `half_span`.
    """

    lift_mm: Millimetres
    """Height in the middle."""
    tilt_mm: PointMm = (0.0, 0.0)
    """Coefficients of u and v."""
    bow_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Coefficients of u², u·v and v²."""
    about: Point = (0.0, 0.0)
    """CAD point at which u = v = 0."""
    half_span: tuple[_HalfSpan, _HalfSpan] = (1.0, 1.0)
    """CAD distances at which u = 1 and v = 1."""

    def height_mm(self, cad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the height (…,) of the board's surface at CAD points (…, 2)."""
        # The polynomial is estimated for |u|, |v| ≤ 1. Beyond 1.2 it is constant, as its squares would grow too large.
        at = np.minimum(np.maximum((np.asarray(cad) - self.about) / self.half_span, -1.2), 1.2)
        u, v = at[..., 0], at[..., 1]
        (a, b), (c, d, e) = self.tilt_mm, self.bow_mm
        return np.asarray(self.lift_mm + a * u + b * v + c * u * u + d * u * v + e * v * v)

    @property
    def bounds_mm(self) -> tuple[float, float]:
        """Two heights between which the surface lies everywhere."""
        most = sum(abs(v) * 1.2 for v in self.tilt_mm) + sum(abs(v) * 1.2**2 for v in self.bow_mm)
        return self.lift_mm - most, self.lift_mm + most


class Stitch(FrozenModel):
    """The result of stitching: M_ij, C, D_j, surface, verdict and quality figures."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    """NaN and infinity are written to JSON as such. As null, they would look like missing values."""

    format: Literal["vaoi-stitch"] = "vaoi-stitch"
    version: Literal[1] = 1
    method: str
    """The method that made it."""
    image_matrices: tuple[tuple[Matrix | None, ...], ...]
    """M_ij of every camera and row. Null: not placed, or the image shows another part of the board than its row."""
    cad_matrix: Matrix | None
    """C; null if it was not found."""
    row_motion: tuple[Matrix, ...]
    """D_j of every row."""
    status: Status
    """Verdict. Degraded: usable, see the reasons."""
    reasons: tuple[str, ...] = ()
    """Sentences: why it is not ok."""
    reason_codes: tuple[str, ...] = ()
    """The code of every entry of `reasons` (`ReasonCode`); empty in results of older versions."""
    quality: dict[str, Any] = Field(default_factory=dict)
    """The numbers behind the verdict."""
    surface: Surface | None = None
    """The board's height above the calibrated plane, where it was estimated."""
    components: dict[str, tuple[tuple[Whole, Whole, Pixels, Pixels], ...]] | None = None
    """By address: [camera, row, x, y] of the footprint's centre in raw pixels of every image that shows it. Empty: M_ij
    · C."""
    camera_matrices: tuple[Matrix, ...] | None = None
    """N_i of every camera as it was in this run: the calibrated N_i, corrected by the displacement that the run shows.

    It is None in results of older versions, which assumed that the calibrated N_i are exact."""

    local_matrices: dict[str, Matrix] | None = None
    """C of each component that its local fiducials place, by address; other components follow their board."""
    board_matrices: dict[str, Matrix] | None = None
    """C of each board of a panel that its fiducials place, by position; other boards follow `cad_matrix`."""

    skipped_boards: tuple[str, ...] | None = None
    """Positions of the boards of a panel that are bad, as their marks show: their components are not demanded."""

    @model_validator(mode="after")
    def _one_code_per_reason(self) -> Self:
        if self.reason_codes and len(self.reason_codes) != len(self.reasons):
            raise ValueError(f"reason_codes has {len(self.reason_codes)} entries, must have {len(self.reasons)}")
        return self

    @model_validator(mode="after")
    def _one_matrix_per_frame(self) -> Self:
        lengths = sorted({len(rows) for rows in self.image_matrices})
        if len(lengths) > 1:
            raise ValueError(f"image_matrices has cameras of {lengths} rows; all must have the same number")
        if lengths and self.row_motion and len(self.row_motion) != lengths[0]:
            raise ValueError(f"row_motion has {len(self.row_motion)} entries, must have one per row: {lengths[0]}")
        return self

    def image_from_tester(self, camera: int, row: int) -> Projective | None:
        """Return M_ij of a camera and row; None if stitching could not place that frame."""
        m = self.image_matrices[camera][row]
        return None if m is None else Projective(m, System.IMAGE, System.TESTER)

    def cameras(self, calibrated: Sequence[Camera]) -> tuple[Camera, ...]:
        """Return the cameras with the displacements that this run showed; `calibrated` are the cameras without them."""
        if self.camera_matrices is None:
            return tuple(calibrated)
        return tuple(
            replace(camera, image_from_row=Projective(np.asarray(n), System.IMAGE, System.ROW))
            for camera, n in zip(calibrated, self.camera_matrices, strict=True)
        )

    def component_matrix(self, address: str) -> NDArray[np.float64] | None:
        """Return the matrix (3, 3) from CAD to tester coordinates that holds for a component; None without C."""
        own = (self.local_matrices or {}).get(address)
        if own is None and self.board_matrices is not None:
            position, separator, _ = address.partition("/")
            own = self.board_matrices.get(position) if separator else None
        return self.cad_matrix if own is None else own

    def displacements(self, addresses: Iterable[str]) -> dict[str, NDArray[np.float64]]:
        """Return, by address, the matrices (3, 3) of those components that do not follow C.

        They take CAD coordinates of a component to those of the same place by C.
        """
        if self.cad_matrix is None or not (self.local_matrices or self.board_matrices):
            return {}
        back = np.linalg.inv(self.cad_matrix)
        matrices = {address: self.component_matrix(address) for address in addresses}
        return {ref: back @ m for ref, m in matrices.items() if m is not None and m is not self.cad_matrix}

    def footprints(self, board_type: BoardType, components: Sequence[Component]) -> list[NDArray[np.float64]]:
        """Return the corners (4, 2) of each component's footprint where it lies, as CAD coordinates of its places by C.

        Pictures of the board and of its regions follow C. Components that do not are displaced in them.
        """
        moves = self.displacements(c.address for c in components)
        nominal = ((c.address, board_type.footprint(c)) for c in components)
        return [apply(moves[ref], corners) if ref in moves else corners for ref, corners in nominal]

    @property
    def tester_from_cad(self) -> Projective | None:
        """The CAD matrix C; None if the detections could not be assigned to fiducials."""
        return None if self.cad_matrix is None else Projective(self.cad_matrix, System.TESTER, System.CAD)


_SIGMAS = 3.0
"""A measured top that is less than this many standard deviations above the board is taken to lie on it."""
_MOST_SIGMA_MM = 0.2
"""Largest standard deviation of a measured height that counts more than the height of the board type."""

Heights = Mapping[str, tuple[float, float]]
"""Measured heights of components and their standard deviations, mm, by address."""


class BodyHeight(NamedTuple):
    """The height of a body above the board's surface."""

    mm: float
    sigma_mm: float | None
    """Standard deviation of a measured height; None for a height of the board type, whose tolerance is not known."""
    source: Literal["measured", "board-type"]


def body_height(part: Component, board_type: BoardType, result: Stitch) -> BodyHeight | None:
    """Return the height of a component's body; None if it is neither measured nor stated by the board type.

    A board may have another part than its CAD data state, or none, so a sure measurement comes before the board type,
    and an unsure one after it.
    """
    height, sigma = (_figure(result.quality.get(key), part.address) for key in ("heights_mm", "height_sigma_mm"))
    measured = None if height is None or sigma is None else BodyHeight(height, sigma, "measured")
    if part.body_height is None or (sigma is not None and sigma <= _MOST_SIGMA_MM and measured is not None):
        return measured
    return BodyHeight(part.body_height * board_type.mm_per_unit, None, "board-type")


def known_height_mm(part: Component, board_type: BoardType, result: Stitch) -> float:
    """Return the height of a component's top above the board; 0 if none is known, or the top may lie on the board."""
    height = body_height(part, board_type, result)
    if height is None or height.mm <= _SIGMAS * (height.sigma_mm or 0.0):
        return 0.0
    return height.mm


def with_heights(result: Stitch, heights_mm: Heights) -> Stitch:
    """Return a result with heights measured from all frames in place of those that follow from its links."""
    if not heights_mm:
        return result
    columns = {"heights_mm": 0, "height_sigma_mm": 1}
    changed = {}
    for key, column in columns.items():
        table = result.quality.get(key)
        own = table if isinstance(table, dict) else {}
        changed[key] = {**own, **{ref: values[column] for ref, values in heights_mm.items()}}
    return result.model_copy(update={"quality": {**result.quality, **changed}})


def _figure(figures: Any, ref: str) -> float | None:
    # `quality` accepts any keys and values, so that readers of older versions can open newer results.
    value = figures.get(ref) if isinstance(figures, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
