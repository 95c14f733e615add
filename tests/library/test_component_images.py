"""Figures of component images."""

from __future__ import annotations

import numpy as np

import vaoi_station as vaoi
from vaoi_station.library.component_images import ComponentImage


def test_a_figure_has_a_tile_for_every_image(stitched: vaoi.StitchedRun) -> None:
    images = stitched.component("U1")
    figure = images.figure()
    assert figure.ndim == 3
    assert figure.shape[2] == 3
    assert len(images) == len(list(images)) == len(images.images)
    assert figure.std() > 10, "pictures were drawn, not an empty sheet"


def made_image(loads: list[int], shape: tuple[int, ...] = (30, 40)) -> ComponentImage:
    """Return an image that counts how often its pixels are loaded."""

    def load() -> np.ndarray:
        loads.append(len(loads))
        return np.full(shape, 90, np.uint8)

    crop_from_cad = np.array([[0.0, 20, 5], [-20, 0, 7], [0, 0, 1]])
    return ComponentImage(
        camera=1,
        row=4,
        coverage=0.75,
        px_per_mm=20.0,
        crop_from_cad=crop_from_cad,
        image_from_crop=np.eye(3),
        distorted=False,
        covariance_px2=None,
        _load=load,
    )


def test_pixels_are_loaded_at_each_access_and_not_before() -> None:
    loads: list[int] = []
    image = made_image(loads)
    assert loads == []
    assert image.pixels.shape == image.pixels.shape == (30, 40)
    assert len(loads) == 2
