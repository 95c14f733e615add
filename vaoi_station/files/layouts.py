"""Read and write layout.json, the marks of a calibration board."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.model import MM_PER_UNIT, FrozenModel, Place, Positive
from vaoi_station.model.frozen_model import MOST_MM

_MOST_MARK_MM = 100.0


class LayoutMark(FrozenModel):
    """Shape and size of every mark of the board, in the unit of the layout."""

    shape: Literal["cross"] = "cross"
    size: Positive
    width: Positive
    """Width of one arm of a mark, in the unit of the layout."""
    polarity: Literal["dark", "light"] = "dark"


class Layout(FrozenModel):
    """The marks of a calibration board. The coordinates of their positions become tester coordinates."""

    unit: Literal["mm", "inch", "mil"] = "mm"
    mark: LayoutMark
    marks: Annotated[tuple[Place, ...], Field(min_length=4)]

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
