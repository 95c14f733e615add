"""The marks of a calibration board in one frame, so that a person sees before a trial whether a camera shows them."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field, model_validator

from vaoi_station.api.cameras.trials import CameraTrials
from vaoi_station.api.setup.design import nominal_heads
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.calibration.mark_detection import MarkAppearance, detect_marks
from vaoi_station.calibration.nominal_view import is_in_frame, nominal_matrix
from vaoi_station.errors import InputError
from vaoi_station.files.layouts import Layout
from vaoi_station.geometry.transforms import apply
from vaoi_station.model import Strict
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.runs.control.coordinator import StationCoordinator

_SMALLEST_PX = 5.0
"""Size of the smallest marks that are searched; noise looks like smaller ones."""

_LAID_MM = 2.0
"""How far from its place a board may be laid: marks nearer to the edge of a view, also of neighbours, may be cut."""


class MarksRequest(Strict):
    """A request to search one frame, of a run or of a trial of the camera, for the marks of a calibration board."""

    run: str | None = Field(
        default=None, min_length=1, max_length=64, description="Id of a run whose frames can still be read."
    )
    row: int | None = Field(default=None, ge=0, le=100_000)
    trial: int | None = Field(
        default=None, ge=1, le=10**9, description="Number of the newest trial of the camera, in place of run and row."
    )
    camera: int = Field(ge=0, le=1000)
    layout: Layout = Field(description="The marks of the calibration board: the `layout.json` of its artwork.")
    pitch_mm: float | None = Field(
        default=None, gt=0, le=10_000, description="Distance of neighbouring cameras, where station.toml states none."
    )
    px_per_mm: float | None = Field(
        default=None, ge=0.1, le=1000, description="Resolution of the cameras, where station.toml states none."
    )

    @model_validator(mode="after")
    def _names_one_frame(self) -> MarksRequest:
        given = self.run is not None, self.row is not None, self.trial is not None
        if given not in ((True, True, False), (False, False, True)):
            raise ValueError("must have either run and row, or trial")
        return self


class FoundMarks(BaseModel):
    """The marks that a frame shows, and how many it should."""

    width: int
    height: int
    found: list[tuple[float, float]] = Field(description="Where marks like those of the layout are, raw pixels.")
    expected: int = Field(description="Marks of the layout that are in view even if the board lies 2 mm off.")
    blur_px: float = Field(description="Blur of their edges, as a standard deviation.")


def find_marks(
    coordinator: StationCoordinator, trials: CameraTrials, files: StationFiles, wanted: MarksRequest
) -> FoundMarks:
    """Search a frame for marks; refuse a camera that the station does not have, and an array without nominal values."""
    heads = nominal_heads([c.head for c in files.config.cameras], wanted.pitch_mm, wanted.px_per_mm)
    if wanted.camera >= len(heads):
        raise InputError.field("body", "camera", wanted.camera, f"below {len(heads)}, the cameras of the station")
    head, layout = heads[wanted.camera], wanted.layout
    marks_mm = np.array([(m.x, m.y) for m in layout.marks]) * layout.mm_per_unit
    if wanted.run is None or wanted.row is None:
        grey = eight_bit_grey(trials.frame(wanted.camera, wanted.trial))
    else:
        grey = eight_bit_grey(coordinator.frame(wanted.run, wanted.camera, wanted.row)[0])
    scale = head.nominal_px_per_mm or 1.0
    marks = MarkAppearance.of(layout, scale)
    most = min(grey.shape) / 2
    if not _SMALLEST_PX <= marks.size_px <= most:
        size = f"{marks.size_px:.1f} px in a frame"
        raise InputError.field("body", "layout.mark.size", size, f"{_SMALLEST_PX:.0f} … {most:.0f} px")
    detected = detect_marks(grey, marks)
    places_px = apply(nominal_matrix(head, wanted.camera), marks_mm)
    return FoundMarks(
        width=grey.shape[1],
        height=grey.shape[0],
        found=[(round(float(x), 2), round(float(y), 2)) for x, y in detected.px],
        expected=int(is_in_frame(head, places_px, marks.margin_px + _LAID_MM * scale).sum()),
        blur_px=round(detected.blur_px, 2),
    )
