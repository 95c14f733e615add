"""Tables of a scenario: marks, codes and panel of the board, and its surroundings, the belt's texture and a carrier."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from vaoi_station.simulation.camera_array import Finite, Index, Positive, Section


class FiducialMark(Section):
    """A fiducial of bare copper. Its position is in mm from the top left corner of the board as the camera sees it."""

    x_mm: Finite
    y_mm: Finite
    diameter_mm: Positive = 1.0
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"


class CodeSection(Section):
    """A code that is printed on every board, with its serial number. Its position is that of its middle."""

    x_mm: Finite
    y_mm: Finite
    module_mm: Annotated[float, Field(ge=0.05, le=2)] = 0.3
    symbology: Literal["datamatrix", "qr"] = "datamatrix"
    text: Annotated[str, Field(min_length=1, max_length=200)] = "{name};{serial}"
    turned_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    inverted: bool = False
    dot_modules: Annotated[float, Field(ge=0.5, le=1)] | None = None
    """Diameter of the dots of which the code is made, as a share of a module; None: solid modules."""
    panel: str | int | None = None


Look = Literal["dark", "light", "blank"]


class BadMarkSection(Section):
    """The mark of every board of a panel that states whether it is bad. Its position counts from the board's corner."""

    x_mm: Finite
    y_mm: Finite
    diameter_mm: Positive = 2.0
    good: Look = "light"
    bad: Look = "dark"


class PanelBoardSection(Section):
    """The place of a board on the panel, as CAD data state it, and how the real board differs from it."""

    x_mm: Finite
    y_mm: Finite
    rotated_deg: Literal[0, 90, 180, 270] = 0
    shift_mm: tuple[Finite, Finite] = (0.0, 0.0)
    turn_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    mark: Literal["good", "bad", "half"] = "good"


class PanelSection(Section):
    """The boards of a panel: equal ones, each with its fiducials and its bad-board mark."""

    width_mm: Annotated[float, Field(ge=8, le=4000)]
    length_mm: Annotated[float, Field(ge=8, le=4000)]
    boards: Annotated[tuple[PanelBoardSection, ...], Field(min_length=1, max_length=200)]
    fiducials: tuple[FiducialMark, ...] = ()
    bad_mark: BadMarkSection | None = None


class TextureSection(Section):
    """The texture of the belt, or of what else is seen beside the board: random grey levels about the belt's grey."""

    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 0.0
    grain_mm: Annotated[float, Field(gt=0, le=5)] = 0.15
    follows: Annotated[float, Field(ge=-2, le=2)] = 1.0
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    seed: Index = 1


class CarrierSection(Section):
    """The carrier in which boards ride: a frame around the board that moves with it, with marks beside the board."""

    rim_mm: Annotated[float, Field(ge=0, le=200)] = 0.0
    grey: Annotated[float, Field(ge=0, le=255)] = 120.0
    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 4.0
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    marks: tuple[FiducialMark, ...] = ()
    seed: Index = 1
