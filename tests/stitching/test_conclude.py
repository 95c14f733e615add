"""Conclusions of a simulated board: their stages, their provenance, and what is left without a board type."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Status, Stitch
from vaoi_station.stitching.conclude import NO_BOARD_TYPE
from vaoi_station.stitching.work import TaskRunner, all_tasks


def test_image_matrices_are_camera_matrix_times_row_motion(filmed: Any) -> None:
    stitch = filmed.stitch
    for camera, matrices in zip(stitch.cameras(filmed.setup.cameras), stitch.image_matrices, strict=True):
        for motion, matrix in zip(stitch.row_motion, matrices, strict=True):
            np.testing.assert_allclose(matrix, camera.image_from_row.matrix @ motion, rtol=1e-12)


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


@pytest.fixture(scope="module")
def without_board_type(filmed: Any) -> Any:
    setup = replace(filmed.setup, board_type=None)
    runner = TaskRunner(setup, filmed.frame)
    tasks = all_tasks(filmed.present, dict(enumerate(filmed.times_s)), setup)
    return runner.conclude_with_findings(filmed.times_s, filmed.present, [runner.perform(t) for t in tasks])


def test_without_a_board_type_there_are_image_matrices_and_a_reason(filmed: Any, without_board_type: Any) -> None:
    stitch, findings = without_board_type
    assert stitch.status == Status.FAILED
    assert NO_BOARD_TYPE.reason in stitch.reasons
    assert stitch.cad_matrix is None
    assert stitch.components is None
    assert isinstance(findings.found, Failure)
    assert findings.found is NO_BOARD_TYPE
    assert all(m is not None for row in stitch.image_matrices for m in row)
