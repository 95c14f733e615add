"""Schemas of the heights of a run's components, as they are stored, exported and served."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.model import Strict

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class HeightInterval(Strict):
    """A range of heights that explain the pictures of a component."""

    low_mm: Number
    high_mm: Number
    probability: Number = Field(description="Probability that the height lies in it.")


class HeightEntry(Strict):
    """The height of one component above the board."""

    height_mm: Number | None = Field(None, description="Absent where several heights are probable.")
    sigma_mm: Number | None = Field(None, description="Standard deviation of `height_mm`.")
    views: int = Field(strict=True, description="Number of frames that show the component; a height needs two.")
    low_mm: Number | None = Field(None, description="Interval that contains the height with a probability of 0.99:")
    high_mm: Number | None = Field(None, description="absent if `height_mm` is known, or if nothing can be said.")
    intervals: tuple[HeightInterval, ...] | None = Field(
        None, description="The parts of this interval that explain the pictures, if there are several."
    )
    expected_mm: Number | None = Field(None, description="`body_height` of the board type.")
    comparison: Literal["agrees", "lower", "higher", "ambiguous", "unknown"] | None = Field(
        None,
        description="Statement about `expected_mm`: `agrees` with a probability of at least 0.95, `lower` or `higher` "
        "of at least 0.995. `ambiguous`: several `intervals` are left, compare the part by eye.",
    )
    probability: Number | None = Field(None, description="Probability of the statement, or of the best one.")

    @model_validator(mode="after")
    def _has_both_or_neither(self) -> Self:
        if (self.height_mm is None) != (self.sigma_mm is None):
            raise ValueError("has only one of height_mm and sigma_mm; must have both or neither")
        return self


class HeightList(Strict):
    """The heights of a run's components, by address."""

    heights: dict[str, HeightEntry]
