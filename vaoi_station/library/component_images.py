"""Temporary images of one component as numpy arrays, with their matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files.contact_sheet import Tile, contact_sheet
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status, Stitch
from vaoi_station.rendering.request import Plane


@dataclass(frozen=True, eq=False)
class ComponentImage:
    """The temporary image of one component, cut from one frame (paper, section 3.4)."""

    camera: int
    row: int
    coverage: float
    """Share of the component's footprint that lies inside the frame, 0 … 1."""
    px_per_mm: float
    crop_from_cad: Floats
    """Matrix (3, 3) from CAD coordinates (unit of the board type) to pixels of this image."""
    image_from_crop: Floats
    """Matrix (3, 3) from pixels of this image to pixels of the frame; to undistorted pixels if `distorted` is True."""
    distorted: bool
    """Whether lens distortion over this image is too large for a matrix. The image itself is corrected."""
    covariance_px2: Floats | None
    """Predicted covariance (2, 2) of the component's place in the frame; None if its centre is outside the frame."""
    _load: Callable[[], NDArray[Any]] = field(repr=False)
    sigma_px: float | None = None
    """Standard deviation of that place in the direction in which it is largest."""
    sigma_mm: float | None = None
    """The same on the board."""
    view_azimuth_deg: float | None = None
    """Direction in CAD from which the component is seen, from x towards y; None if unknown or straight from above."""
    view_angle_deg: float | None = None
    """Angle between the line of sight and the vertical; None if the calibration states no working distance."""
    sharpness_per_mm: float | None = None
    """RMS gradient divided by the standard deviation of the grey levels, 1/mm; None if it was not measured."""
    saturated: float | None = None
    """Share of the footprint's pixels at the largest grey level; None if it was not measured."""
    time_s: float | None = None
    """Time of the row's pulse after that of row 0."""
    exposure_us: float | None = None
    gain: float | None = None
    light: str | None = None
    """Name of the light pattern of the row; None if it has none."""
    plane: Plane = "board"
    """Plane in which the image is right: the board's surface, or the top of the body."""
    height_mm: float = 0.0
    """Height of that plane above the board's surface."""
    minus: tuple[int, int] | None = None
    """Camera and row of the frame that was subtracted; None for a plain image."""

    @property
    def cad_from_crop(self) -> Floats:
        """Matrix (3, 3) from pixels of this image to CAD coordinates."""
        return np.asarray(np.linalg.inv(self.crop_from_cad))

    @property
    def pixels(self) -> NDArray[Any]:
        """The image, (height, width) or (height, width, 3) blue-green-red. It is rendered or fetched at each access."""
        # Not cached, because a caller that visits all components would hold all their images.
        return self._load()


@dataclass(frozen=True, eq=False)
class ComponentImages:
    """All images of one component: in the order of the request, by default best first."""

    ref: str
    images: tuple[ComponentImage, ...]
    height_mm: float | None
    """Estimated height of the body above the board; None if it was not estimated."""
    height_sigma_mm: float | None
    status: Status
    """Verdict of the run."""
    remark: str | None = None
    """Why the images lie in another plane than requested; None if they do not."""

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[ComponentImage]:
        return iter(self.images)

    def __getitem__(self, index: int) -> ComponentImage:
        return self.images[index]

    def figure(self) -> NDArray[np.uint8]:
        """Draw all images side by side, with the verdict above them; return (height, width, 3) blue-green-red."""
        tiles = [Tile(image.pixels, f"c{image.camera} r{image.row}", f"{image.coverage:.0%}") for image in self]
        facts = [f"{len(self)} images"]
        if self.height_mm is not None:
            sigma = f" ± {self.height_sigma_mm:.2f}" if self.height_sigma_mm is not None else ""
            facts.append(f"height {self.height_mm:.2f}{sigma} mm")
        return contact_sheet(tiles, self.ref, self.status, facts)


def made_image(known: Mapping[str, Any], load: Callable[[], NDArray[Any]]) -> ComponentImage:
    """Return the image that a reply of a station, or `rendering.selection.describe`, describes by its fields."""
    figures = {f.name: known[f.name] for f in fields(ComponentImage) if f.init and f.name != "_load"}
    for name in ("crop_from_cad", "image_from_crop", "covariance_px2"):
        figures[name] = None if figures[name] is None else np.array(figures[name])
    return ComponentImage(**figures, _load=load)


def component_height(result: Stitch, ref: str) -> tuple[float | None, float | None]:
    """Return the estimated height of a component above the board and its standard deviation, mm."""

    def figure(key: str) -> float | None:
        figures = result.quality.get(key, {})  # from a file, whose `quality` is not checked
        value = figures.get(ref) if isinstance(figures, dict) else str(figures)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise InputError.field("the result", f"quality.{key}", value, "an object of numbers by ref")
        return value

    return figure("heights_mm"), figure("height_sigma_mm")
