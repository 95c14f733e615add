"""The result document of a simulated board is consistent and cannot be changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import Stitch


def test_image_matrices_are_camera_matrix_times_row_motion(filmed: Any) -> None:
    stitch = filmed.stitch
    for camera, matrices in zip(stitch.cameras(filmed.setup.cameras), stitch.image_matrices, strict=True):
        for motion, matrix in zip(stitch.row_motion, matrices, strict=True):
            np.testing.assert_allclose(matrix, camera.image_from_row.matrix @ motion, rtol=1e-12)


def test_matrices_are_read_only(filmed: Any) -> None:
    stitch = filmed.stitch
    for matrix in (stitch.cad_matrix, stitch.row_motion[1], stitch.image_matrices[0][1]):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 1.0


def test_the_document_that_skipped_validation_is_valid(filmed: Any) -> None:
    document = filmed.stitch.model_dump(mode="json")
    assert Stitch.model_validate(document).model_dump(mode="json") == document


def test_every_component_has_the_views_of_the_truth(filmed: Any) -> None:
    stitch = filmed.stitch
    assert set(stitch.components) == set(filmed.truth["views"])
    assert filmed.error_px(stitch) < 0.5


def test_a_row_that_nothing_places_has_no_matrices(filmed: Any) -> None:
    """Without the frames around it the last row is linked to no other."""
    last = max(j for _, j in filmed.present)
    frames = {key: pixels for key, pixels in filmed.frames.items() if not last - 4 < key[1] < last}
    stitch = filmed.stitched(frames=frames)
    assert {len(row) for row in stitch.image_matrices} == {last + 1}
    there = [m is not None for m in stitch.image_matrices[0]]
    assert there[: last - 4] == [True] * (last - 4)
