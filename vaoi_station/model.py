"""The nouns of the house, frozen: what a recording, a calibration, a board type and a stitch are.

Shapes, units and names are those of `docs/formats.md`; `files/` reads and writes them. Keys that begin
with `x_` belong to the user: they are kept and ignored. Cameras and rows count from 0.
"""

from __future__ import annotations

import math
from collections import Counter
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.outline import crossing, encloses

MOST = {"components": 20_000, "fiducials": 1_000, "outline": 10_000, "fixture_marks": 10_000}
"""How much of a kind a board type may have."""
MM_PER_UNIT = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}


def _matrix(value: Any) -> NDArray[np.float64]:
    try:
        m = np.array(value)
    except ValueError as error:
        raise ValueError("has rows of different lengths, must be 3×3") from error
    if m.dtype.kind not in "iuf":
        raise ValueError("is not a matrix of numbers, must be 3×3 numbers")
    m = m.astype(np.float64)
    if m.shape != (3, 3):
        raise ValueError(f"has shape {m.shape}, must be 3×3")
    if not np.isfinite(m).all():
        raise ValueError("has NaN or infinite entries, all must be finite")
    if _is_singular(m):
        raise ValueError("is singular, must be invertible")
    m.setflags(write=False)
    return m


def _is_singular(m: NDArray[np.float64]) -> bool:
    """By the determinant after rows and columns are brought to size 1: px, mm and 1/mm stand in one matrix."""
    for axis in (1, 0):
        size = np.abs(m).max(axis=axis, keepdims=True)
        if not size.all():
            return True
        m = m / size
    return bool(abs(np.linalg.det(m)) < 1e-12)


Matrix = Annotated[NDArray[np.float64], BeforeValidator(_matrix), PlainSerializer(lambda m: m.tolist())]
"""A finite, invertible 3×3 matrix; row-major nested lists in files."""

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
"""Whole numbers that are written as numbers; texts and truth values are refused, as for the others."""
Point = tuple[Finite, Finite]


class Noun(BaseModel):
    """Frozen; unknown keys are refused but for the user's own `x_…`."""

    model_config = ConfigDict(frozen=True, extra="allow", arbitrary_types_allowed=True)

    @model_validator(mode="after")
    def _only_known_keys(self) -> Self:
        unknown = [k for k in self.model_extra or {} if not k.startswith("x_")]
        if unknown:
            raise ValueError(f"unknown key(s) {', '.join(map(repr, unknown))}; own keys must begin with 'x_'")
        return self


class CameraHead(Noun):
    """What a recording says of one camera."""

    width: Annotated[Whole, Field(ge=16, le=65536)]
    height: Annotated[Whole, Field(ge=16, le=65536)]
    exposure_us: Positive
    nominal_center_mm: Point | None = None
    nominal_px_per_mm: Positive | None = None


class RecordingHead(Noun):
    """recording.json: what was filmed, without the pictures."""

    format: Literal["vaoi-recording"]
    version: Literal[1]
    cameras: Annotated[tuple[CameraHead, ...], Field(min_length=1)]
    rows: Annotated[Whole, Field(ge=1)]
    trigger_period_s: Positive
    conveyor_mm_s: Point
    missing: tuple[tuple[Whole, Whole], ...] = ()
    trigger_times_s: tuple[Finite, ...] | None = None
    exposures_us: tuple[tuple[Positive, ...], ...] | None = None
    lights: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n, m = len(self.cameras), self.rows
        for camera, row in self.missing:
            if not (0 <= camera < n and 0 <= row < m):
                raise ValueError(f"missing names [{camera}, {row}], but there are {n} cameras and {m} rows (from 0)")
        for key in ("trigger_times_s", "exposures_us", "lights"):
            value = getattr(self, key)
            if value is not None and len(value) != m:
                raise ValueError(f"{key} has {len(value)} entries, must have one per row: {m}")
        if self.exposures_us and any(len(row) != n for row in self.exposures_us):
            raise ValueError(f"exposures_us must have {n} entries in every row, one per camera")
        if self.trigger_times_s and (np.diff(self.trigger_times_s) <= 0).any():
            raise ValueError("trigger_times_s must increase from row to row")
        return self

    def row_times_s(self) -> NDArray[np.float64]:
        """Time of each pulse, (rows,) s."""
        if self.trigger_times_s is not None:
            return np.array(self.trigger_times_s)
        return np.asarray(np.arange(self.rows) * self.trigger_period_s, dtype=np.float64)

    def exposure_us(self, camera: int, row: int) -> float:
        """Exposure time of one frame."""
        return self.exposures_us[row][camera] if self.exposures_us else self.cameras[camera].exposure_us


class Distortion(Noun):
    """Radial distortion of one lens; see `geometry.Lens`."""

    center: Point
    radius: Positive
    radial: tuple[Finite, ...]


class Calibration(Noun):
    """calibration.json: the camera matrices N_i (tester → undistorted image) and what belongs to them."""

    format: Literal["vaoi-calibration"]
    version: Literal[1]
    unit: Literal["mm"]
    camera_matrices: Annotated[tuple[Matrix, ...], Field(min_length=1)]
    working_distance_mm: Positive | None = None
    residual_px: tuple[Finite, ...] | None = None
    principal_point: tuple[Point, ...] | None = None
    created: str | None = None
    covariances: Any = None
    distortion: tuple[Distortion, ...] | None = None

    @model_validator(mode="after")
    def _one_entry_per_camera(self) -> Self:
        n = len(self.camera_matrices)
        for key in ("residual_px", "principal_point", "distortion"):
            value = getattr(self, key)
            if value is not None and len(value) != n:
                raise ValueError(f"{key} has {len(value)} entries, must have one per camera: {n}")
        return self

    def cameras(self, heads: tuple[CameraHead, ...]) -> tuple[Camera, ...]:
        """The calibrated cameras, given the sizes of their frames."""
        return tuple(self._camera(i, head) for i, head in enumerate(heads))

    def _camera(self, i: int, head: CameraHead) -> Camera:
        d = self.distortion[i] if self.distortion else None
        return Camera(
            width_px=head.width,
            height_px=head.height,
            image_from_row=Projective(self.camera_matrices[i], System.IMAGE, System.ROW),
            lens=Lens(d.center, d.radius, d.radial) if d else Lens((0.0, 0.0), 1.0),
            working_distance_mm=self.working_distance_mm,
            principal_point_px=self.principal_point[i] if self.principal_point else None,
        )


class Fiducial(Noun):
    """A mark of the board at known CAD coordinates."""

    name: str
    x: Finite
    y: Finite
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    diameter: Positive


class Component(Noun):
    """One part: its footprint's centre, size before rotation, and rotation, in CAD units and degrees."""

    ref: Annotated[str, Field(min_length=1, pattern=r"^[^\x00-\x1f\x7f]+$")]
    center: Point
    width: Positive
    height: Positive
    rotation: Finite = 0.0
    body_height: Annotated[Finite, Field(ge=0)] | None = None
    panel: str | int | None = None

    @property
    def address(self) -> str:
        """`panel/ref` on a panel, else `ref`; unique within a board type."""
        return self.ref if self.panel is None else f"{self.panel}/{self.ref}"


class FixtureMarkShape(Noun):
    """How the marks of the fixture look."""

    shape: Literal["cross", "circle", "square", "diamond"] = "cross"
    size: Positive
    width: Positive | None = None
    polarity: Literal["dark", "light"] = "light"


class Place(Noun):
    """A point with named coordinates."""

    x: Finite
    y: Finite


class BoardType(Noun):
    """board.json: a product of the line, in its own unit and axes."""

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
    unit: Literal["mm", "inch", "mil"] = "mm"
    y_axis: Literal["up", "down"] = "up"
    side: Literal["top", "bottom"] = "top"
    outline: tuple[Point, ...] | None = None
    fiducials: tuple[Fiducial, ...] = ()
    components: tuple[Component, ...] = ()
    fixture_mark: FixtureMarkShape | None = None
    fixture_marks: tuple[Place, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _refuse_crowds(self)
        _refuse_twins([c.address for c in self.components], "components")
        _refuse_twins([f.name for f in self.fiducials], "fiducials")
        if self.outline is not None:
            if len(self.outline) < 2:
                raise ValueError("outline has one point; it is two opposite corners or a polygon")
            low, high = self.extent()
            if (high <= low).any():
                raise ValueError(f"outline has no area: from {low.tolist()} to {high.tolist()}")
            if edges := crossing(self.outline):
                raise ValueError(f"outline crosses itself: its edges from corners {edges[0]} and {edges[1]} meet")
            for f in self.fiducials:
                if not encloses(self.outline, (f.x, f.y)):
                    raise ValueError(
                        f"fiducial {f.name!r} at ({f.x}, {f.y}) lies outside the outline "
                        f"{low.tolist()} … {high.tolist()} {self.unit}"
                    )
        if self.fixture_marks and self.fixture_mark is None:
            raise ValueError("fixture_marks are given, but not their shape: fixture_mark is missing")
        return self

    @property
    def mm_per_unit(self) -> float:
        """Size of one CAD unit."""
        return MM_PER_UNIT[self.unit]

    @property
    def mirrors(self) -> bool:
        """Whether CAD → image flips handedness (`formats.md`): y_axis up differs from side bottom."""
        return (self.y_axis == "up") != (self.side == "bottom")

    def extent(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner in CAD units: of the outline, else of all that is placed."""
        points: list[Any] = [*(self.outline or ())]
        if not points:
            points = [(f.x, f.y) for f in self.fiducials]
            points += [corner for c in self.components for corner in self.footprint(c)]
        p = np.array(points, dtype=np.float64).reshape(-1, 2)
        if not len(p):
            raise ValueError(f"board type {self.name!r} has neither outline nor fiducials nor components")
        return p.min(0), p.max(0)

    def component(self, address: str) -> Component | None:
        """The component of that address; None if there is none."""
        return next((c for c in self.components if c.address == address), None)

    def footprint(self, component: Component) -> NDArray[np.float64]:
        """Corners (4, 2) in CAD; rotation is counter-clockwise as seen on the top, whichever way y points."""
        a = math.radians(component.rotation if self.y_axis == "up" else -component.rotation)
        half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (component.width / 2, component.height / 2)
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.asarray(half @ turn.T + component.center)


class Status(StrEnum):
    """The verdict on a stitch."""

    OK = "ok"
    DEGRADED = "degraded"
    FAILED = "failed"


class Surface(Noun):
    """The board's height above the calibrated plane, mm; `about` (CAD) and `half_span` scale the polynomial."""

    lift_mm: Finite
    tilt_mm: Point = (0.0, 0.0)
    bow_mm: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    about: Point = (0.0, 0.0)
    half_span: Point = (1.0, 1.0)

    def height_mm(self, cad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (…,) of the board's surface at CAD points (…, 2)."""
        at = np.clip((np.asarray(cad) - self.about) / self.half_span, -1.2, 1.2)
        u, v = at[..., 0], at[..., 1]
        terms = (*self.tilt_mm, *self.bow_mm)
        return np.asarray(self.lift_mm + sum(c * b for c, b in zip(terms, (u, v, u * u, u * v, v * v), strict=True)))


class Stitch(Noun):
    """A result: M_ij, C, D_j, the verdict and its evidence; immutable once written."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    """So that a number that JSON does not have is noticed, not turned into null."""

    format: Literal["vaoi-stitch"] = "vaoi-stitch"
    version: Literal[1] = 1
    method: str
    image_matrices: tuple[tuple[Matrix | None, ...], ...]
    cad_matrix: Matrix | None
    row_motion: tuple[Matrix, ...]
    status: Status
    reasons: tuple[str, ...] = ()
    quality: dict[str, Any] = Field(default_factory=dict)
    surface: Surface | None = None
    components: dict[str, tuple[tuple[int, int, float, float], ...]] | None = None

    @model_validator(mode="after")
    def _one_matrix_per_frame(self) -> Self:
        lengths = sorted({len(rows) for rows in self.image_matrices})
        if len(lengths) > 1:
            raise ValueError(f"image_matrices has cameras of {lengths} rows; all must have the same number")
        if lengths and self.row_motion and len(self.row_motion) != lengths[0]:
            raise ValueError(f"row_motion has {len(self.row_motion)} entries, must have one per row: {lengths[0]}")
        return self

    def image_from_tester(self, camera: int, row: int) -> Projective | None:
        """M_ij, or None where the frame could not be placed."""
        m = self.image_matrices[camera][row]
        return None if m is None else Projective(m, System.IMAGE, System.TESTER)

    @property
    def tester_from_cad(self) -> Projective | None:
        """C, or None where the board's fiducials could not be matched."""
        return None if self.cad_matrix is None else Projective(self.cad_matrix, System.TESTER, System.CAD)


class Verdict(StrEnum):
    """How one (camera, row) of a run ended."""

    OK = "ok"
    INCOMPLETE = "incomplete"
    MISSING = "missing"


class FrameRecord(Noun):
    """One (camera, row) of a run: where its pixels are and what became of it."""

    camera: int
    row: int
    verdict: Verdict
    cause: str = ""
    slot: int | None = None
    """Slot of the ring; None where nothing arrived."""
    frame_id: int | None = None
    camera_time_s: float | None = None
    pulse_error_us: float | None = None
    """Time stamp minus pulse time, after mapping both clocks to the host's."""
    exposure_us: float | None = None
    """Exposure time of the frame, where it is known."""
    light: str = ""
    """Light pattern of its row."""


class Pulse(Noun):
    """One trigger of all cameras, by the controller's clock."""

    index: int
    time_s: float
    light: str = ""


def _refuse_crowds(board: BoardType) -> None:
    """What no board has: so much of something, or of such a size, that it can only be a mistake."""
    for key, most in MOST.items():
        if len(getattr(board, key) or ()) > most:
            raise ValueError(f"{key} has {len(getattr(board, key))} entries, at most {most} are taken")
    mm = board.mm_per_unit
    for c in board.components:
        if not 0.01 <= min(c.width, c.height) * mm <= max(c.width, c.height) * mm <= 2000:
            raise ValueError(f"component {c.address!r} is {c.width}×{c.height} {board.unit}; 0.01 to 2000 mm are taken")
    for n, f in enumerate(board.fiducials):
        if not 0.05 <= f.diameter * mm <= 50:
            raise ValueError(f"fiducial {f.name!r} has diameter {f.diameter} {board.unit}; 0.05 to 50 mm are taken")
        if any(math.dist((f.x, f.y), (g.x, g.y)) * mm < 0.1 for g in board.fiducials[:n]):
            raise ValueError(f"fiducial {f.name!r} lies where another one lies; they must be 0.1 mm apart")


def _refuse_twins(names: list[str], what: str) -> None:
    if twins := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(f"{what} holds {twins[0]!r} twice; names must differ")
