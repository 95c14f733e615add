"""The document of a check: residuals, what does not look as if it were there, warnings and the proposed correction."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from vaoi_station.model import BoardType, Strict

WarningCode = Literal[
    "not-found",
    "mirrored",
    "turned",
    "shifted",
    "scaled",
    "fiducials-elsewhere",
    "components-missing",
    "no-cad-mapping",
]


class Residual(Strict):
    """How the data must be moved to lie on the pictures: mirror x, rotate, scale, shift; as seen from the top, y up."""

    mirrored: bool
    """Whether x is negated first."""
    rotation_deg: float = Field(description="Counter-clockwise as seen from the top.")
    rotation_sigma_deg: float
    """σ of the rotation."""
    scale: float
    """Factor of the size."""
    scale_sigma: float
    """σ of the scale."""
    shift_mm: tuple[float, float] = Field(description="Displacement of the middle of the components.")
    shift_sigma_mm: tuple[float, float]
    """σ of the shift."""


class Unlikely(Strict):
    """A component that does not look as if it were there."""

    ref: str
    """Address of the component."""
    share: float = Field(
        description="Share of other places of the board at which its edges would be weaker; near 1 if it is there."
    )


class CheckedFiducial(Strict):
    """A fiducial, searched where the data put it, and where it lies after the correction."""

    name: str
    """Name of the fiducial."""
    off_mm: float | None = Field(default=None, description="Distance of a mark from the stated place; absent: none.")
    off_corrected_mm: float | None = Field(default=None, description="The same if it moves with the components.")


class CheckWarning(Strict):
    """Something that a person should correct or check."""

    code: WarningCode
    """Code of the warning."""
    message: str
    """The warning in a sentence."""


class BoardCheck(Strict):
    """A board type laid over a stitched run."""

    format: Literal["vaoi-board-check"] = "vaoi-board-check"
    version: Literal[1] = 1
    board_type: str
    """Name of the checked board type."""
    score: float = Field(
        description="By how many standard deviations the edges of all bodies exceed those at other shifts."
    )
    rival_score: float = Field(description="The same for the best other quarter turn or mirrored pose.")
    tester_from_cad: list[list[float]] | None = Field(
        default=None, description="C by the components. Absent: not found."
    )
    residual: Residual | None = Field(default=None, description="Against C of the run; absent without one.")
    components: int
    """Number of components."""
    measured: int = Field(description="Number of components whose centres were measured in the frames; 0: edges only.")
    unlikely: list[Unlikely] = Field(default_factory=list)
    not_filmed: list[str] = Field(default_factory=list, description="Components of which not all was filmed.")
    fiducials: list[CheckedFiducial] = Field(default_factory=list)
    warnings: list[CheckWarning] = Field(default_factory=list)
    moved: list[Literal["components", "fiducials", "outline"]] = Field(default_factory=list)
    """What the correction moves; fiducials with all other marks, the outline with its cut-outs."""
    proposal: BoardType | None = Field(
        default=None, description="The corrected board type; absent: nothing to correct."
    )
