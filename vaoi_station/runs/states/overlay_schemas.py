"""Schemas of what is drawn over the picture of a whole board: frames, links, fiducials, residuals.

Places are CAD coordinates in the unit of the board type, as `image_from_cad` of a mosaic takes them. A residual is a
vector along the CAD axes, in the same unit, and its length in px of the cameras.
"""

from __future__ import annotations

from vaoi_station.runs.states.schemas import Schema

Point = tuple[float, float]


class OverlayFrame(Schema):
    """What one frame shows of the board."""

    camera: int
    row: int
    usable: bool
    """Whether it is complete and proven; other frames are not used."""
    light: str = ""
    corners: tuple[Point, ...]
    """The corners of the frame on the board, going round."""
    sigma_px: float | None = None
    """Standard deviation of its matrix at its worst corner; None if it is not known."""


class OverlayLinks(Schema):
    """The links of two frames."""

    a: tuple[int, int]
    """Camera and row of the first frame."""
    b: tuple[int, int]
    found: int
    used: int
    """Number of links that have weight in the adjustment."""
    at: Point | None = None
    """Mean place of the used links; None without any."""
    residual: Point | None = None
    """Mean residual of the used links: from the point in the first frame to where the second one predicts it."""
    residual_px: float | None = None
    """Length of the mean residual."""
    rms_px: float | None = None
    """Root mean square of the residuals of single links."""
    why: str = ""
    """Why there are no links; empty if there are."""


class OverlayFiducial(Schema):
    """A fiducial of the board type, and where it was seen."""

    name: str
    at: Point
    diameter: float
    sightings: int
    """Number of frames in which it was found."""
    residual: Point | None = None
    """Mean residual; None if it was not found."""
    residual_px: float | None = None


class RunOverlay(Schema):
    """What is drawn over the mosaics of a run."""

    unit: str
    """Unit of the board type, of all places and residuals."""
    px_per_mm: float
    """Mean resolution of the cameras, to which px refer."""
    outline: tuple[Point, ...] = ()
    """Outline of the board: a polygon; empty if the board type has none."""
    frames: tuple[OverlayFrame, ...]
    links: tuple[OverlayLinks, ...]
    """Pairs of frames that were searched for links; empty in runs of earlier versions but for those without links."""
    fiducials: tuple[OverlayFiducial, ...]
