"""Marks of a board type: fiducials, by which boards and components are placed, and marks that place nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.model.frozen_model import Finite, FrozenModel, Positive

FoundBy = Literal["element", "attribute", "package", "name", "place"]
Look = Literal["dark", "light", "blank"]
"""How a mark looks against what surrounds it; blank: as this."""
Position = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[^\x00-\x1f\x7f/]+$")] | int
"""Position of a board on its panel. It has no "/", which separates it from the reference designator in addresses."""


class Fiducial(FrozenModel):
    """A fiducial mark of the board at known CAD coordinates."""

    name: str
    x: Finite
    y: Finite
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    diameter: Positive
    kind: Literal["global", "local"] | None = None
    """Local: of the components below; None: not stated."""
    found_by: FoundBy | None = None
    """How the import has recognised the mark."""
    components: tuple[str, ...] | None = None
    """Addresses of the components that a local fiducial places."""
    panel: Position | None = None
    """Position on the panel of the board that the fiducial belongs to; None: it belongs to the panel, or to the only
    board."""


class OtherMark(FrozenModel):
    """A mark by which no board is placed: a fiducial of the panel, or a mark that states that a board is bad."""

    name: str
    x: Finite
    y: Finite
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    diameter: Positive
    kind: Literal["panel", "bad-board"]
    found_by: FoundBy | None = None
    panel: Position | None = None
    """Of a bad-board mark: position on the panel of the board that it is about."""
    bad: Look | None = None
    """How a bad-board mark looks, against what surrounds it, on a board that is bad; None: the mark is not read."""
    good: Look | None = None
    """How it looks on a board that is not; None: blank."""

    @property
    def read(self) -> bool:
        """Whether the mark is read in every run."""
        return self.kind == "bad-board" and self.bad is not None

    @model_validator(mode="after")
    def _readable(self) -> Self:
        if self.bad is None:
            return self
        if self.kind != "bad-board" or self.panel is None:
            raise ValueError(
                f"mark {self.name!r} states how it looks on a bad board: its kind must be 'bad-board', and `panel` the "
                "position of that board on the panel"
            )
        if self.bad == (self.good or "blank"):
            raise ValueError(f"mark {self.name!r} looks {self.bad} on good and on bad boards; they must differ")
        return self


def fiducials_by_board(fiducials: Sequence[Fiducial]) -> dict[str, tuple[int, ...]]:
    """Return the numbers of the fiducials of each board of a panel, by its position; local ones are of no board."""
    out: dict[str, tuple[int, ...]] = {}
    for n, f in enumerate(fiducials):
        if f.panel is not None and not (f.kind == "local" and f.components):
            out[str(f.panel)] = (*out.get(str(f.panel), ()), n)
    return out


def largest_distance(marks: Sequence[Fiducial]) -> float:
    """Return the largest distance between two fiducials, in CAD units; 0 for fewer than two."""
    places = [(f.x, f.y) for f in marks]
    return max((math.dist(a, b) for a in places for b in places), default=0.0)
