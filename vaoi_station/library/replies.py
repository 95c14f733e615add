"""The parts of a station's replies that the client uses; a newer station may send more."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from vaoi_station.model.frozen_model import Matrix, Point, Positive, Whole
from vaoi_station.rendering.request import Plane
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion
from vaoi_station.runs.states.schemas import BoardTypeSummary


class _Reply(BaseModel):
    model_config = ConfigDict(arbitrary_types_allowed=True, frozen=True)


class RunIdReply(_Reply):
    """The part of a run's summary that identifies it."""

    id: Annotated[str, Field(min_length=1)]


class RunListReply(_Reply):
    """A page of the list of runs; `next` is the id of a run before which the next page begins."""

    runs: list[dict[str, Any]]
    next: str | None = None


class BoardTypeListReply(_Reply):
    """All board types, and the names of those that were deleted and can be restored."""

    board_types: tuple[BoardTypeSummary, ...]
    deleted: tuple[str, ...] = ()


class VersionListReply(_Reply):
    """The versions of a board type that were replaced or deleted, newest first."""

    revisions: tuple[BoardTypeVersion, ...]


class AddressReply(_Reply):
    """One entry of the list of components."""

    address: str


class ComponentListReply(_Reply):
    """The components of a run."""

    components: list[AddressReply]


class ViewReply(_Reply):
    """One view of a component."""

    camera: Whole
    row: Whole
    coverage: Annotated[float, Field(strict=True, ge=0, le=1)]
    px_per_mm: Positive
    crop_from_cad: Matrix
    image_from_crop: Matrix
    distorted: Annotated[bool, Field(strict=True)]
    covariance_px2: tuple[Point, Point] | None = None
    sigma_px: float | None = None
    sigma_mm: float | None = None
    view_azimuth_deg: float | None = None
    view_angle_deg: float | None = None
    sharpness_per_mm: float | None = None
    saturated: float | None = None
    time_s: float | None = None
    exposure_us: float | None = None
    gain: float | None = None
    light: str | None = None
    plane: Plane = "board"
    height_mm: float = 0.0
    minus: tuple[Whole, Whole] | None = None
    url: Annotated[str, Field(pattern=r"^(/[^/?#]+)*/api/")]


class ComponentReply(_Reply):
    """All views of one component."""

    remark: str | None = None
    views: list[ViewReply]


class MergedReply(_Reply):
    """One picture that is merged of several frames."""

    k: Whole
    merged: tuple[tuple[Whole, Whole], ...]
    """(camera, row) of the frames, best first."""
    exposures: Whole
    """Number of different exposures; with 1, saturated places have no value."""
    lights: tuple[str, ...]
    width_px: Whole
    height_px: Whole
    px_per_mm: Positive
    plane_height_mm: float
    """Height above the board of the plane in which frames are merged."""
    crop_from_cad: Matrix
    cad_from_crop: Matrix
    url: Annotated[str, Field(pattern=r"^(/[^/?#]+)*/api/.*\?")]


class MergedListReply(_Reply):
    """The merged pictures of a component or region."""

    pictures: tuple[MergedReply, ...]


class MosaicReply(_Reply):
    """One picture of a whole board."""

    name: str
    light: str | None = None
    exposure_us: float | None = None
    hdr: bool
    width_px: Whole
    height_px: Whole
    px_per_mm: Positive
    levels: Whole
    image_from_cad: Matrix
    """CAD → pixels of the largest picture; centres of pixels are integers."""
    dzi: str
    tiff: str
    """Addresses as Deep Zoom Image, and as a file."""


class MosaicListReply(_Reply):
    """The pictures of a whole board."""

    mosaics: tuple[MosaicReply, ...]
