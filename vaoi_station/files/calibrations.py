"""Read and write calibration.json, and layout.json, the marks of a calibration board."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.geometry import Projective, System
from vaoi_station.model import MM_PER_UNIT, Calibration, CameraHead, FrozenModel, Place, Positive
from vaoi_station.model.frozen_model import MOST_MM

_LEAST_PX_PER_MM, _MOST_PX_PER_MM = 0.05, 5000.0
_MOST_APART = 4.0
"""Largest accepted factor between the resolution of a camera and the median of the array's resolutions."""
_FROM_DESIGN = 1.5
"""Largest accepted factor between a resolution and its nominal value. A wrong lens or distance gives a larger one."""


def read_calibration(path: Path, cameras: int | Sequence[CameraHead] | None = None) -> Calibration:
    """Read a calibration. Refuse an impossible calibration, and one that belongs to another array.

    Args:
        path: path of calibration.json.
        cameras: number of cameras, or their heads. With heads, each resolution must also be near the head's
            `nominal_px_per_mm`, if that is given.

    Raises:
        InputError: the calibration is refused; the message names file, camera, value and limit.
    """
    data = read_json(path)
    check_format(data, path, "vaoi-calibration", 1)
    calibration = parse(Calibration, data, path)
    found = len(calibration.camera_matrices)
    filming = len(cameras) if isinstance(cameras, Sequence) else cameras
    if filming is not None and found != filming:
        raise InputError(
            f"{path}: camera_matrices has {found} entries, but {filming} cameras were filming.",
            action="Use the calibration of this array.",
        )
    _check_views(calibration, path)
    if isinstance(cameras, Sequence):
        _check_design(calibration, tuple(cameras), path)
    return calibration


def _check_views(calibration: Calibration, path: Path) -> None:
    """Raise InputError if a resolution is impossible, or if only some cameras of an array mirror the board."""
    # The scale of a homography is arbitrary, so resolutions are compared, and not elements of matrices.
    views = [Projective(matrix, System.IMAGE, System.ROW) for matrix in calibration.camera_matrices]
    scales = [view.scale_at(view.inverse()((0.0, 0.0))) for view in views]
    usual, mirrored = float(np.median(scales)), [view.mirrors for view in views]
    for i, scale in enumerate(scales):
        if not _LEAST_PX_PER_MM <= scale <= _MOST_PX_PER_MM:
            limit = f"between {_LEAST_PX_PER_MM:g} and {_MOST_PX_PER_MM:g} px/mm"
        elif not 1 / _MOST_APART <= scale / usual <= _MOST_APART:
            limit = f"within a factor of {_MOST_APART:g} of the array's median, {usual:.4g} px/mm"
        else:
            continue
        raise InputError(
            f"{path}: camera_matrices.{i} gives camera {i} a resolution of {scale:.4g} px/mm, but it must be {limit}.",
            action="Calibrate again, or use the calibration of this array.",
        )
    if len(set(mirrored)) > 1:
        # The minority is reported: it is more likely that one camera is wrong than all others.
        odd = mirrored.index(sum(mirrored) * 2 <= len(mirrored))
        raise InputError(
            f"{path}: camera_matrices.{odd} has a determinant of the other sign than most: camera {odd} "
            f"{'mirrors' if mirrored[odd] else 'does not mirror'} the board, but all cameras of an array must agree.",
            action="Calibrate again with one layout for all cameras.",
        )


def _check_design(calibration: Calibration, heads: tuple[CameraHead, ...], path: Path) -> None:
    """Raise InputError if the resolution at a frame's centre is far from the camera's nominal resolution."""
    for i, (camera, head) in enumerate(zip(calibration.cameras(heads), heads, strict=True)):
        nominal = head.nominal_px_per_mm
        if nominal is None or 1 / _FROM_DESIGN <= camera.px_per_mm / nominal <= _FROM_DESIGN:
            continue
        raise InputError(
            f"{path}: camera_matrices.{i} gives camera {i} a resolution of {camera.px_per_mm:.4g} px/mm in the middle "
            "of its frame, "
            f"but it must be within a factor of {_FROM_DESIGN:g} of its nominal_px_per_mm, {nominal:.4g}.",
            action="Use the calibration of this array, or correct nominal_px_per_mm.",
        )


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration atomically: readers see either the old file or the complete new one."""
    write_json(path, calibration.model_dump(mode="json", exclude_none=True))


_MOST_MARK_MM = 100.0


class LayoutMark(FrozenModel):
    """Shape and size of every mark of the board, in the unit of the layout."""

    shape: Literal["cross"] = "cross"
    """Shape of the marks."""
    size: Positive
    """Size from tip to tip."""
    width: Positive
    """Width of one arm of a mark, in the unit of the layout."""
    polarity: Literal["dark", "light"] = "dark"
    """Against the ground."""


class Layout(FrozenModel):
    """The marks of a calibration board. The coordinates of their positions become tester coordinates."""

    unit: Literal["mm", "inch", "mil"] = "mm"
    """Unit of all numbers of the file."""
    mark: LayoutMark
    """Look of every mark."""
    marks: Annotated[tuple[Place, ...], Field(min_length=4)]
    """Centres of the marks; each camera sees four or more."""

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        mm = self.mm_per_unit
        if not self.mark.width * mm <= self.mark.size * mm <= _MOST_MARK_MM:
            raise ValueError(
                f"mark has size {self.mark.size:g} and width {self.mark.width:g} {self.unit}; "
                f"width must be at most size, and size at most {_MOST_MARK_MM:g} mm"
            )
        for n, place in enumerate(self.marks):
            if not max(abs(place.x), abs(place.y)) * mm <= MOST_MM:
                raise ValueError(
                    f"marks.{n} is at ({place.x:g}, {place.y:g}) {self.unit}, "
                    f"must be within ±{MOST_MM:g} mm of the origin"
                )
        return self

    @property
    def mm_per_unit(self) -> float:
        """Size of one unit of the layout in mm."""
        return MM_PER_UNIT[self.unit]


def read_layout(path: Path) -> Layout:
    """Read the layout of a calibration board."""
    return parse(Layout, read_json(path), path)


def write_layout(path: Path, layout: Layout) -> None:
    """Write a layout atomically: readers see either the old file or the complete new one."""
    write_json(path, layout.model_dump(mode="json", exclude_none=True))
