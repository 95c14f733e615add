"""The marks to detect, and their size in the frames of each camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vaoi_station.calibration.nominal_view import marks_in_view
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import read_calibration
from vaoi_station.files.layouts import Layout, read_layout
from vaoi_station.marks.mark_shape import CROSS_ARM, Shape

SMALLEST_PX = 5.0
"""Smallest size of a mark that can be detected."""


@dataclass(frozen=True)
class MarkSpec:
    """The marks that one camera should detect."""

    shape: Shape
    size_px: float
    arm: float = CROSS_ARM
    light: bool | None = None
    """True for light marks on dark ground, False for dark on light, None if both are searched."""
    expected: int | None = None
    """Number of marks of the layout that lie in the camera's view; None if unknown."""


def mark_specs(
    config: StationConfig, shape: Shape | None, size_mm: float | None, layout: Path | None, px_per_mm: float | None
) -> tuple[MarkSpec | None, ...]:
    """Return one specification per camera; None for a camera in whose frames no marks are searched.

    Args:
        config: configuration of the station.
        shape: shape of the marks, given together with `size_mm`; a layout contains both.
        size_mm: size of a mark.
        layout: path of the layout of a calibration board.
        px_per_mm: resolution of the frames; by default that of the calibration, else the nominal one of the camera.

    Raises:
        InputError: shape and size are incomplete or given twice, or the resolution is unknown.
    """
    if layout is not None and (shape is not None or size_mm is not None):
        raise InputError("--layout already defines the marks.", action="Leave out --mark and --mark-size-mm.")
    if layout is None and (shape is None) != (size_mm is None):
        missing = "--mark-size-mm" if size_mm is None else "--mark"
        raise InputError(f"{missing} is missing.", action="Give both, or the --layout of the calibration board.")
    if layout is None and size_mm is None:
        return (None,) * len(config.cameras)
    scales = _resolutions(config, px_per_mm)
    if layout is not None:
        known = read_layout(layout)
        return tuple(_of_layout(known, config, i, scale) for i, scale in enumerate(scales))
    assert shape is not None
    assert size_mm is not None
    return tuple(_checked(MarkSpec(shape, size_mm * scale), i) for i, scale in enumerate(scales))


def _of_layout(layout: Layout, config: StationConfig, camera: int, px_per_mm: float) -> MarkSpec:
    mark, head = layout.mark, config.cameras[camera].head
    expected = None
    if head.nominal_center_mm is not None and head.nominal_px_per_mm is not None:
        places = np.array([(m.x, m.y) for m in layout.marks]) * layout.mm_per_unit
        expected = len(marks_in_view(head, camera, places))
    size_px = mark.size * layout.mm_per_unit * px_per_mm
    return _checked(MarkSpec(mark.shape, size_px, mark.width / mark.size, mark.polarity == "light", expected), camera)


def _checked(spec: MarkSpec, camera: int) -> MarkSpec:
    if spec.size_px < SMALLEST_PX:
        raise InputError.field(
            f"camera {camera}", "size of a mark", f"{spec.size_px:.1f} px", f"at least {SMALLEST_PX} px"
        )
    return spec


def _resolutions(config: StationConfig, px_per_mm: float | None) -> Sequence[float]:
    """Return the resolution of every camera in px per mm."""
    # In this order: the caller's value, the calibration, the nominal value of the configuration.
    if px_per_mm is not None:
        return [px_per_mm] * len(config.cameras)
    heads = tuple(c.head for c in config.cameras)
    if config.calibration.is_file():
        return [c.px_per_mm for c in read_calibration(config.calibration, heads).cameras(heads)]
    found = [h.nominal_px_per_mm for h in heads]
    if None in found:
        raise InputError(
            f"cameras.{found.index(None)}.nominal_px_per_mm is missing and there is no calibration yet, so the "
            "size of a mark in its frames is unknown.",
            action="Give --px-per-mm, or set the nominal resolution in station.toml.",
        )
    return [v for v in found if v is not None]
