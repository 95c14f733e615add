"""What a tester sends about a board that it has clamped, and what it receives: lengths are in the tester's unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from vaoi_station.files.documents import parse
from vaoi_station.model import Reason, Status, Strict
from vaoi_station.model.board_type import ONE_LINE, Position
from vaoi_station.model.frozen_model import Finite, Point, Positive

MM_PER_UNIT = {"mm": 1.0, "um": 1e-3, "inch": 25.4, "mil": 0.0254}
MOST_READINGS, MOST_POINTS = 200, 20_000
_Name = Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)]
_Ppm = Annotated[Positive, Field(ge=1e-3, le=1e5)]


class Reading(Strict):
    """A fiducial where the tester has found it."""

    fiducial: _Name = Field(description="Its name in the board type.")
    x: Finite
    y: Finite
    z: Finite | None = Field(default=None, description="Height, rising from the filmed side towards the probe.")
    sigma: Positive | None = Field(default=None, description="σ of x and of y, if not that of the request.")
    sigma_z: Positive | None = None


class CadPoint(Strict):
    """A point in CAD coordinates, in the unit of the board type."""

    x: Finite
    y: Finite
    board: Position | None = Field(default=None, description="Position on the panel of the board that it lies on.")
    name: str = Field(default="", max_length=200, description="Returned with the answer.")


class ClampedRequest(Strict):
    """The tester's readings of fiducials, and what it asks for."""

    readings: tuple[Reading, ...] = Field(
        min_length=1, max_length=MOST_READINGS, description="Fiducials where the tester has found them."
    )
    sigma: Positive = Field(description="Standard deviation of a reading, of x and of y.")
    sigma_z: Positive | None = Field(default=None, description="That of z; needed if readings state z.")
    unit: Literal["mm", "um", "inch", "mil"] = Field(
        default="mm", description="Unit of all lengths of the request and of the reply."
    )
    y_axis: Literal["up", "down"] = Field(
        default="up", description="Where y points if x points right, as the filmed side is seen."
    )
    turn_deg: Finite | None = Field(
        default=None, description="Expected angle of the CAD x axis in the tester's coordinates, good to 10°."
    )
    turn_sigma_deg: Annotated[Positive, Field(ge=1e-6, le=30)] = Field(
        default=0.5,
        description="Its σ. A single reading leaves the turn to it; if it is stated, the turn of two is checked by it.",
    )
    scale_ppm: _Ppm = Field(default=100.0, description="How well the tester's scale agrees with the cameras', 1 σ.")
    shear_ppm: _Ppm = Field(default=100.0, description="How well its axes agree in scale and right angle, 1 σ.")
    bow: Positive | None = Field(default=None, description="How far clamping may bend the board, 1 σ; else 0.2 mm.")
    thickness: Positive | None = Field(default=None, description="Thickness of the board; else 1.6 mm.")
    points: tuple[_Name | CadPoint, ...] = Field(
        default=(),
        max_length=MOST_POINTS,
        description="Test points (`U1-3`), components or fiducials by name, or CAD points.",
    )
    nets: tuple[_Name, ...] = Field(default=(), max_length=MOST_POINTS, description="All test points of these nets.")
    pads_of: tuple[_Name, ...] = Field(
        default=(), max_length=MOST_POINTS, description="All test points of these components."
    )
    test_points: bool = Field(default=False, description="All test points of the side.")
    clearance: Positive | None = Field(
        default=None, description="Height above the board at which the probe travels: higher bodies are returned."
    )
    margin: Annotated[Finite, Field(ge=0)] = Field(default=0.0, description="Added around each keep-out solid.")


def request_of(readings: Mapping[str, Sequence[float]], options: Mapping[str, Any]) -> ClampedRequest:
    """Return a request with readings (x, y) or (x, y, z) by the name of their fiducial; raise InputError for others."""
    listed = [{"fiducial": name, **dict(zip("xyz", map(float, at), strict=False))} for name, at in readings.items()]
    return parse(ClampedRequest, {"readings": listed, **options}, "clamped")


class Strain(Strict):
    """A change of shape, in millionths, with its standard deviation."""

    ppm: float
    sigma_ppm: float


class ClampedTransform(Strict):
    """Where a board, or a region of it, lies in the tester's coordinates."""

    board: str | None = Field(default=None, description="Position on the panel; absent: the whole board or panel.")
    components: tuple[str, ...] = Field(default=(), description="The components that local fiducials place.")
    fiducials: tuple[str, ...] = Field(description="The readings that determine it.")
    matrix: tuple[tuple[float, float, float], ...] = Field(description="3×3, CAD coordinates to the tester's.")
    turn_deg: float = Field(description="Angle of the CAD x axis.")
    pivot: Point
    covariance: tuple[tuple[float, ...], ...] = Field(
        description="6×6: shift x and y, turn, scale, stretch (x longer, y shorter) and shear about `pivot`."
    )
    scale: Strain
    stretch: Strain
    shear: Strain


class ReadingResidual(Strict):
    """How far a reading lies from where the others expect it."""

    fiducial: str
    x: float
    y: float
    z: float | None = None
    sigmas: float | None = Field(
        default=None, description="Its distance in standard deviations; absent if it cannot be checked."
    )
    used: bool


class DistanceChange(Strict):
    """The distance of two fiducials as filmed, and its change as read."""

    fiducials: tuple[str, str]
    filmed: float
    change: float
    sigma: float


class Bend(Strict):
    """What changed of the board's shape: height = bow · (u², u·v, v²), u and v being ±1 at the board's edges."""

    tilt: Point
    bow_change: tuple[float, float, float]
    sigma: tuple[float, float, float]


class ClampedPoint(Strict):
    """A point in the tester's coordinates, on the board's surface."""

    name: str
    x: float
    y: float
    z: float
    slope_x: float
    slope_y: float
    sigma_x: float
    sigma_y: float
    sigma_z: float
    sigma_slope: float
    net: str | None = Field(default=None, description="Of a test point.")
    top: float | None = Field(default=None, description="Of a component: z of the top of its body, if it is known.")
    sigma_top: float | None = Field(default=None, description="Absent if the height is that of the board type.")


class KeepOut(Strict):
    """A body that the probe must not touch: a prism over `corners` up to `top`."""

    component: str
    corners: tuple[Point, Point, Point, Point]
    top: float | None = Field(default=None, description="Absent if the height of the body is not known.")
    source: Literal["measured", "board-type", "unknown"]


class Clamped(Strict):
    """Where the board lies that a tester has clamped."""

    status: Status = Field(description="ok; degraded: usable, see the reasons; failed: there are no points.")
    reasons: tuple[Reason, ...] = ()
    remarks: tuple[str, ...] = Field(default=(), description="What the readings do not show.")
    unit: str
    z_from: Literal["readings", "fiducials"] = Field(
        description="The tester's z, or the height above the plane through the fiducials, as filmed."
    )
    transforms: tuple[ClampedTransform, ...] = ()
    residuals: tuple[ReadingResidual, ...] = ()
    distances: tuple[DistanceChange, ...] = Field(default=(), description="The 20 that changed most, by their σ.")
    bend: Bend | None = Field(default=None, description="Only if readings state z.")
    points: tuple[ClampedPoint, ...] = ()
    keep_outs: tuple[KeepOut, ...] = ()
