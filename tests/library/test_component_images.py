"""Figures of component images."""

from __future__ import annotations

import vaoi_station as vaoi


def test_a_figure_has_a_tile_for_every_image(stitched: vaoi.StitchedRun) -> None:
    images = stitched.component("U1")
    figure = images.figure()
    assert figure.ndim == 3
    assert figure.shape[2] == 3
    assert len(images) == len(list(images)) == len(images.images)
    assert figure.std() > 10, "pictures were drawn, not an empty sheet"


def test_images_come_best_first(stitched: vaoi.StitchedRun) -> None:
    for ref in stitched.refs:
        coverage = [round(image.coverage, 3) for image in stitched.component(ref)]
        assert coverage == sorted(coverage, reverse=True)
