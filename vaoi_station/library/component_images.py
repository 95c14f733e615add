"""Temporary images of one component as numpy arrays, with their matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status
from vaoi_station.rendering.contact_sheet import Tile, contact_sheet


@dataclass(frozen=True, eq=False)
class ComponentImage:
    """The temporary image of one component, cut from one frame (paper, section 3.4)."""

    camera: int
    row: int
    coverage: float
    """Share of the component that lies inside the frame, 0 … 1."""
    px_per_mm: float
    crop_from_cad: Floats
    """Matrix (3, 3) from CAD coordinates (unit of the board type) to pixels of this image."""
    image_from_crop: Floats
    """Matrix (3, 3) from pixels of this image to pixels of the frame; to undistorted pixels if `distorted` is True."""
    distorted: bool
    """Whether lens distortion over this image is too large for a matrix. The image itself is corrected."""
    covariance_px2: Floats | None
    """Predicted covariance (2, 2) of the component's centre in the frame; None if the centre is outside the frame."""
    _load: Callable[[], NDArray[Any]] = field(repr=False)

    @property
    def cad_from_crop(self) -> Floats:
        """Matrix (3, 3) from pixels of this image to CAD coordinates."""
        return np.asarray(np.linalg.inv(self.crop_from_cad))

    @property
    def pixels(self) -> NDArray[Any]:
        """The image, (height, width) or (height, width, 3) blue-green-red. It is rendered or fetched at each access."""
        # The image is not cached: otherwise, a caller that visits all components of a board would hold all their
        # images.
        return self._load()


@dataclass(frozen=True, eq=False)
class ComponentImages:
    """All images of one component: first those with full coverage, nearest to the centre of their frame first."""

    ref: str
    images: tuple[ComponentImage, ...]
    height_mm: float | None
    """Estimated height of the body above the board; None if it was not estimated."""
    height_sigma_mm: float | None
    status: Status
    """Verdict of the run."""

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[ComponentImage]:
        return iter(self.images)

    def __getitem__(self, index: int) -> ComponentImage:
        return self.images[index]

    def figure(self) -> NDArray[np.uint8]:
        """Draw all images side by side, with the verdict above them; return (height, width, 3) blue-green-red."""
        tiles = [Tile(image.pixels, f"c{image.camera} r{image.row}", f"{image.coverage:.0%}") for image in self]
        # A height is estimated from parallax between views, so a component may have images and no height.
        facts = [f"{len(self)} images"]
        if self.height_mm is not None:
            sigma = f" ± {self.height_sigma_mm:.2f}" if self.height_sigma_mm is not None else ""
            facts.append(f"height {self.height_mm:.2f}{sigma} mm")
        return contact_sheet(tiles, self.ref, self.status, facts)
