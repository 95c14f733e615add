"""Stitching of a whole recording: frames that are missing are never asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.stitching.recordings.offline import stitch_frames


def test_all_frames_are_read_and_missing_ones_are_not(filmed: Any) -> None:
    asked: set[tuple[int, int]] = set()

    def frame(camera: int, row: int) -> Any:
        asked.add((camera, row))
        return filmed.frame(camera, row)

    head = filmed.head.model_copy(update={"missing": ((0, 1), (1, 4))})
    result = stitch_frames(filmed.setup, head, frame)
    assert asked == {key for key in filmed.present if key not in ((0, 1), (1, 4))}
    assert result.image_matrices[0][1] is not None, "the other camera places the row"


def test_the_result_is_the_same_every_time(filmed: Any) -> None:
    again = stitch_frames(filmed.setup, filmed.head, filmed.frame)
    assert again.cad_matrix is not None
    assert np.array_equal(again.cad_matrix, filmed.stitch.cad_matrix)
    assert np.array_equal(again.row_motion, filmed.stitch.row_motion)
    assert again.components == filmed.stitch.components
