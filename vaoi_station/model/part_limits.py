"""Limits beyond which the measures of parts are marked. They mark and judge nothing: the verdict of a run stays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from vaoi_station.model.frozen_model import MOST_MM, Finite, FrozenModel

Probability = Annotated[Finite, Field(ge=0, le=1)]
Amount = Annotated[Finite, Field(ge=0, le=MOST_MM)]
Limits = dict[str, float]
"""The limits of one part, by the names of `PartLimits`."""
_PROBABILITIES = ("presence", "orientation", "alike")
_AMOUNTS = ("dx_mm", "dy_mm", "turn_deg")


class PartLimits(FrozenModel):
    """The limits of one part, package or board type; what is None is taken from the next more general level."""

    presence: Probability | None = Field(None, description="Least probability that the part is there.")
    orientation: Probability | None = Field(None, description="Least probability that it is the right way round.")
    alike: Probability | None = Field(None, description="Least likeness to good boards.")
    dx_mm: Amount | None = Field(None, description="Largest shift along the CAD's x axis, either way.")
    dy_mm: Amount | None = Field(None, description="Largest shift along the CAD's y axis, either way.")
    turn_deg: Annotated[Finite, Field(ge=0, le=180)] | None = Field(None, description="Largest turn, either way.")
    least_height_mm: Amount | None = Field(None, description="Least height above the board.")
    most_height_mm: Amount | None = Field(None, description="Largest height above the board.")

    def values(self) -> Limits:
        """Return the limits that are stated."""
        return {name: value for name in type(self).model_fields if (value := getattr(self, name)) is not None}


class BoardLimits(FrozenModel):
    """The limits of a board type; of several for one part, its own counts, then that of its package."""

    every: PartLimits | None = Field(None, description="Limits of all parts.")
    packages: dict[str, PartLimits] = Field(default_factory=dict, description="Limits by package.")
    parts: dict[str, PartLimits] = Field(default_factory=dict, description="Limits by address of the part.")

    def by_part(self, packages: Mapping[str, str | None]) -> dict[str, Limits]:
        """Return the limits of the parts that have some, by address; `packages` are those of all parts by address."""
        general, own = (self.every or PartLimits()).values(), {k: v.values() for k, v in self.parts.items()}
        of_package = {k: v.values() for k, v in self.packages.items()}
        merged = {a: general | of_package.get(package or "", {}) | own.get(a, {}) for a, package in packages.items()}
        return {address: limits for address, limits in merged.items() if limits}


def beyond(limits: Limits, measure: Mapping[str, Any]) -> list[str]:
    """Return which measures of a part, as in a document of parts, are beyond limits.

    What cannot be said of a part is beyond none; the `reasons` of the part say why it cannot.
    """
    turns = measure.get("orientation")
    found = {**measure, "orientation": None if turns is None else turns.get("0", 0.0)}
    known = {name: value for name, value in found.items() if value is not None}
    marked = [name for name in _PROBABILITIES if known.get(name, 1.0) < limits.get(name, 0.0)]
    marked += [name for name in _AMOUNTS if name in limits and abs(known.get(name, 0.0)) > limits[name]]
    height = known.get("height_mm")
    if height is not None and not (
        limits.get("least_height_mm", height) <= height <= limits.get("most_height_mm", height)
    ):
        marked.append("height_mm")
    return marked
