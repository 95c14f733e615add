"""The parts of a station's replies that the public API uses, checked before use.

Unknown keys are accepted, so that a newer station may send more. Everything else that differs is a `DeviceError`.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vaoi_station.demo.client import unusable_reply
from vaoi_station.files.documents import describe
from vaoi_station.model.frozen_model import Matrix, Point, Positive, Whole
from vaoi_station.rendering.view import Plane

M = TypeVar("M", bound=BaseModel)


class _Reply(BaseModel):
    """Base class of all replies."""

    model_config = ConfigDict(arbitrary_types_allowed=True, frozen=True)


class RunIdReply(_Reply):
    """The part of a run's summary that identifies it."""

    id: Annotated[str, Field(min_length=1)]


class RunListReply(_Reply):
    """A page of the list of runs."""

    runs: list[dict[str, Any]]


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
    url: Annotated[str, Field(pattern=r"^/api/")]


class ComponentReply(_Reply):
    """All views of one component."""

    remark: str | None = None
    views: list[ViewReply]


def checked(model: type[M], reply: Any, url: str) -> M:
    """Validate a reply.

    Raises:
        DeviceError: the reply is empty, lacks a key, or has a value of another type; the message names address and key.
    """
    try:
        return model.model_validate(reply)
    except ValidationError as error:
        raise unusable_reply(url, f"another document than expected: {describe(error, 'reply').rstrip('.')}") from error
