"""Request and response models that only the REST interface has; the others are in `runs.states.schemas`.

A field without a value is left out of a reply. It is never null, so that every field has one type.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from vaoi_station.config import MethodName
from vaoi_station.model import Strict
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.schemas import BoardTypeSummary, Choice, FlipAxis, RunSummary

Matrix3 = list[list[float]]
# Control characters would break the lines of logs and messages, and labels and other programs do not show them.
PLAIN_TEXT = r"^[^\x00-\x1f\x7f]*$"
PlainText = Annotated[str, Field(pattern=PLAIN_TEXT)]
"""A text in one line."""
# A code on a board may have the separators of ISO/IEC 15434 (EOT, FS, GS, RS, US), and its whole text may be the id.
CALLER_ID = r"^[^\x00-\x03\x05-\x1b\x7f]*$"
CallerId = Annotated[str, Field(pattern=CALLER_ID)]
"""An id of a board, as the caller states it or as a code on the board has it."""
PREVIEW_ID = r"^[0-9a-f]{16}$"


class ArmRequest(Strict):
    """The order for the next boards. The same fields may also be given as query parameters."""

    board_type: str | None = Field(default=None, max_length=200, description="Name of a stored board type.")
    board_id: CallerId | None = Field(
        default=None, min_length=1, max_length=200, description="The caller's id of the board."
    )
    job_id: PlainText | None = Field(
        default=None, min_length=1, max_length=200, description="The caller's id of the job."
    )
    runs: int | None = Field(default=None, ge=1, le=1_000_000, description="Disarm after this number of runs.")
    orders: bool | None = Field(
        default=None, description="In place of a board type: film the boards for which orders wait, and no others."
    )
    allow_lost_cameras: bool | None = Field(
        default=None, description="Arm although a camera is not ready; boards are filmed without it."
    )
    passing: Passing | None = Field(
        default=None,
        description="While a board passes, which keeps the order before: `wait` until it has left (the default), take "
        "effect `after` it and reply at once, or `refuse`.",
    )


class OrderRequest(Strict):
    """An order for one board."""

    board_type: str = Field(min_length=1, max_length=200, description="Name of a stored board type.")
    board_id: CallerId | None = Field(default=None, min_length=1, max_length=200, description="Id of the board.")
    job_id: PlainText | None = Field(default=None, min_length=1, max_length=200, description="Id of the job.")
    skip: tuple[Annotated[PlainText, Field(min_length=1, max_length=80)], ...] = Field(
        default=(), max_length=1000, description="Positions of the boards of a panel that are not to be tested."
    )
    side: Literal["top", "bottom"] | None = Field(
        default=None, description="The side that is filmed; refused if the board type describes the other one."
    )
    flip: FlipAxis | None = Field(
        default=None,
        description="Axis of the tester about which the board was turned over since its other side was filmed "
        "here, lying as `rotation_deg` of station.toml states: this side is expected as it lies then.",
    )
    priority: int = Field(default=0, ge=-1000, le=1000, description="Orders of a higher priority come first.")
    allow_lost_cameras: bool = Field(default=False, description="Film the board although a camera is not ready.")


class OrderChange(Strict):
    """Another place of an order in the queue: a position or a priority."""

    position: int | None = Field(default=None, ge=1, le=1000, description="Position, 1 for the next board.")
    priority: int | None = Field(default=None, ge=-1000, le=1000, description="As that of a new order.")


class BoardTypeList(Strict):
    """All board types, sorted by name."""

    board_types: list[BoardTypeSummary]
    deleted: list[str] = Field(default=[], description="Names of deleted board types that can be restored.")


class BoardTypeVersions(Strict):
    """The versions of a board type that were replaced or deleted, newest first."""

    revisions: list[BoardTypeVersion]


class StateRequest(Strict):
    """A request to set the state of a board type."""

    state: BoardTypeState = Field(description="A draft is armed with a warning, a retired board type is not armed.")
    revision: PlainText | None = Field(default=None, min_length=1, max_length=40, description="Revision of the data.")


class CorrectionRequest(Strict):
    """A request to store the correction that a check against a run proposes."""

    run: str = Field(min_length=1, max_length=64, description="Id of the finished run of the check.")
    revision: PlainText | None = Field(
        default=None,
        min_length=1,
        max_length=40,
        description="Revision of the corrected data [that of the data, with `corrected`].",
    )


class TeachRequest(Strict):
    """A request to make a run the reference of its board type."""

    run: str = Field(min_length=1, max_length=64, description="Id of a finished run of the board type.")
    confirm_orientation: bool = Field(
        default=False,
        description="A person has checked that the board lay as its board type says, not turned by 180°.",
    )


class DecisionRequest(Strict):
    """What a person has decided about a run."""

    choice: Choice = Field(description="Film the board again, or use its pictures in spite of the verdict.")
    name: PlainText = Field(min_length=1, max_length=80, description="Name of the person.")
    reason: PlainText = Field(min_length=1, max_length=400, description="Why.")


class MethodRequest(Strict):
    """A request to set the stitching method of a board type."""

    method: MethodName = Field(description="The method from the next run on.")


class RunPage(Strict):
    """One page of the list of runs, newest first."""

    runs: list[RunSummary]
    next: str | None = Field(default=None, description="Value of `before` for the next page; absent on the last page.")


class IdentityReport(Strict):
    """The id that the next machine of the line has read of the board of a run."""

    board_id: CallerId = Field(
        min_length=1, max_length=200, description="The id, exactly as the station's codes state it."
    )
    machine: PlainText = Field(default="", max_length=80, description="Name of the machine.")


class ComponentEntry(Strict):
    """One component of a run's board type, with its position."""

    address: str = Field(description="`panel/ref` on a panel, else `ref`.")
    ref: str
    panel: str | None = None
    center_mm: tuple[float, float] = Field(description="CAD, in mm.")
    width_mm: float
    height_mm: float
    rotation_deg: float
    tester_mm: tuple[float, float] | None = Field(default=None, description="Position at row 0, tester coordinates.")
    views: int = Field(description="Number of frames that show at least half of it.")
    coverage: float | None = Field(
        default=None, description="Share of its footprint that the good frames show together, 0 … 1."
    )
    in_one_frame: bool | None = Field(default=None, description="Whether one good frame shows the whole footprint.")
    unseen: bool = Field(description="Whether the good frames show less of it than the board type or station asks for.")
    skipped: bool = Field(default=False, description="Whether its board on the panel is crossed out, so not demanded.")
    sigma_px: float | None = Field(
        default=None, description="Standard deviation of its position in its worst view; absent if it is not known."
    )
    sigma_mm: float | None = Field(default=None, description="The same on the board, mm.")
    footprint: list[tuple[float, float]] = Field(
        default=[], description="Corners of its footprint, going round, CAD coordinates (unit of the board type)."
    )
    url: str


class ComponentList(Strict):
    """The components of a run's board type."""

    components: list[ComponentEntry]


class MosaicEntry(Strict):
    """One mosaic of a run: the whole board as one picture."""

    name: str
    light: str | None = Field(default=None, description="Light whose rows it shows; absent: the light of most rows.")
    exposure_us: float | None = Field(
        default=None, description="Exposure of its frames; absent: each camera's most frequent one."
    )
    hdr: bool = Field(description="Whether all exposures are merged. Tiles are then tone-mapped, the file is radiance.")
    width_px: int
    height_px: int
    px_per_mm: float
    levels: int = Field(description="Number of reductions by 2 until the picture fits into one tile.")
    image_from_cad: list[list[float]] = Field(description="CAD → pixels of the largest picture; centres are integers.")
    dzi: str = Field(description="Deep Zoom Image.")
    tiff: str = Field(description="Pyramidal TIFF.")


class KeptMosaicEntry(Strict):
    """The small picture of the whole board that stays when the frames are gone."""

    width_px: int
    height_px: int
    px_per_mm: float
    image_from_cad: list[list[float]] = Field(description="CAD → pixels of the picture; centres are integers.")
    url: str = Field(description="JPEG.")


class MosaicList(Strict):
    """The mosaics of a run."""

    mosaics: list[MosaicEntry] = Field(description="They can be rendered while the frames are in memory.")
    kept: KeptMosaicEntry | None = Field(default=None, description="Absent if no small picture is kept.")


class ViewEntry(Strict):
    """A view: one frame that shows a component, and the temporary image cut from it.

    Matrices act on column vectors (x, y, 1).
    """

    k: int
    camera: int
    row: int
    coverage: float = Field(description="Share of the component's footprint that the frame shows, 0 … 1.")
    off_center: float = Field(
        description="Distance from the frame's centre in half diagonals; 0 is viewed straight from above."
    )
    width_px: int
    height_px: int
    px_per_mm: float = Field(
        description="Resolution as requested. The sides are whole pixels, so the scale, which `crop_from_cad` states, "
        "differs by up to half a pixel over each side."
    )
    covariance_px2: tuple[tuple[float, float], tuple[float, float]] | None = Field(
        default=None,
        description="Covariance of x and y of the component's centre in the frame, as placed by C and M_ij; "
        "absent if the centre is outside the frame.",
    )
    sigma_px: float | None = Field(
        default=None, description="Standard deviation of the component's place in the frame, in the worst direction."
    )
    sigma_mm: float | None = Field(default=None, description="The same on the board, mm.")
    view_azimuth_deg: float | None = Field(
        default=None,
        description="Direction in CAD from which the component is seen, from x towards y, 0 … 360; absent if it is "
        "seen from straight above, or if the calibration states no working distance.",
    )
    view_angle_deg: float | None = Field(
        default=None, description="Angle between the line of sight and the vertical; 0 is straight from above."
    )
    sharpness_per_mm: float | None = Field(
        default=None, description="RMS gradient over standard deviation of grey levels, 1/mm; if it was measured."
    )
    saturated: float | None = Field(
        default=None, description="Share of the footprint's pixels at the largest grey level; if it was measured."
    )
    time_s: float | None = Field(default=None, description="Time of the row's pulse after that of row 0, if known.")
    exposure_us: float | None = Field(default=None, description="Exposure time of the frame, if known.")
    gain: float | None = Field(default=None, description="Linear gain of the frame, if known.")
    light: str | None = Field(default=None, description="Light pattern of the row, if one is configured.")
    white_balance: tuple[float, float, float] | None = Field(
        default=None,
        description="Factors by which red, green and blue of the image were multiplied, so that a white target is "
        "grey; absent without flat fields in colour.",
    )
    crop_from_cad: Matrix3 = Field(description="CAD coordinates (unit of the board type) to pixels of this image.")
    cad_from_crop: Matrix3
    image_from_crop: Matrix3 = Field(
        description="Pixels of this image to pixels of the frame; to undistorted pixels if `distorted` is true."
    )
    plane: Literal["board", "top"] = Field(description="Plane in which this image is right.")
    height_mm: float = Field(description="Height of that plane above the board's surface.")
    minus: tuple[int, int] | None = Field(
        default=None, description="Camera and row of the frame that was subtracted, in a difference of two lights."
    )
    distorted: bool = Field(description="Whether the frame has lens distortion; the image is corrected for it.")
    url: str = Field(description="Address of this image.")


class ComponentViews(Strict):
    """All views of one component."""

    address: str
    px_per_mm: float | None = Field(default=None, description="Resolution of the images; absent if there are none.")
    plane_source: Literal["measured", "board-type"] | None = Field(
        default=None,
        description="With `plane=top`, what the height of the plane is: measured in this run, or `body_height` of the "
        "board type.",
    )
    plane_sigma_mm: float | None = Field(
        default=None, description="Standard deviation of a measured height of the plane, mm; part of `sigma_px`."
    )
    remark: str | None = Field(
        default=None, description="Why the images lie in another plane than requested, if they do."
    )
    views: list[ViewEntry]


class MergedEntry(Strict):
    """One merged picture. Matrices act on column vectors (x, y, 1)."""

    k: int
    merged: list[tuple[int, int]] = Field(description="[camera, row] of the frames it is merged of, best first.")
    exposures: int = Field(description="Number of different exposures; with 1, saturated places have no value.")
    lights: list[str] = Field(description="The light of the frames; empty if lights have no names.")
    width_px: int
    height_px: int
    px_per_mm: float
    plane_height_mm: float = Field(description="Height above the board of the plane in which frames are merged.")
    crop_from_cad: Matrix3 = Field(description="CAD coordinates (unit of the board type) to pixels of the picture.")
    cad_from_crop: Matrix3
    url: str = Field(description="Address of the picture.")


class MergedList(Strict):
    """The merged pictures of a component or region: the paper's m_v pictures, and last the one of all frames."""

    pictures: list[MergedEntry]


class Matrices(BaseModel):
    """The result of a run in the format of `docs/formats.md`. The matrix of a frame that was not placed is null."""

    format: Literal["vaoi-stitch"]
    version: Literal[1]
    method: str
    image_matrices: list[list[Matrix3 | None]] = Field(description="M_ij, tester to image: per camera, one per row.")
    cad_matrix: Matrix3 | None = Field(description="C, CAD to tester.")
    row_motion: list[Matrix3] = Field(description="D_j, one per row.")
    status: Literal["ok", "degraded", "failed"]
    reasons: list[str]
    reason_codes: list[str] = Field(default=[], description="The code of each of `reasons`, see `docs/formats.md`.")
    quality: dict[str, Any]
    surface: dict[str, Any] | None = None
    components: dict[str, list[tuple[int, int, float, float]]] | None = None
    local_matrices: dict[str, Matrix3] | None = Field(
        default=None, description="C of the components that local fiducials place, by address."
    )
    board_matrices: dict[str, Matrix3] | None = Field(
        default=None, description="C of the boards of a panel that their fiducials place, by position on the panel."
    )
    skipped_boards: list[str] | None = Field(
        default=None, description="Positions of the boards of a panel that are crossed out, as their marks show."
    )


class Heartbeat(Strict):
    """State of the station, sent in the event stream after two seconds without an event."""

    time: str
    state: str
    last_event: int


class Health(Strict):
    """Reply of `/healthz`: whether the station can film."""

    status: Literal["ok", "degraded"]
    state: str
    version: str
    codes: list[str] = Field(default=[], description="Codes of the station's reasons and warnings.")
