"""Stitching of a whole recording: frames that are missing are never asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.stitching.work import kept_frames, stitch_frames


def test_each_frame_is_read_once_and_missing_ones_are_not(filmed: Any) -> None:
    asked: list[tuple[int, int]] = []

    def frame(camera: int, row: int) -> Any:
        asked.append((camera, row))
        return filmed.frame(camera, row)

    head = filmed.head.model_copy(update={"missing": ((0, 1), (1, 4))})
    result = stitch_frames(filmed.setup, head, frame)
    assert sorted(asked) == [key for key in sorted(filmed.present) if key not in ((0, 1), (1, 4))]
    assert result.image_matrices[0][1] is not None, "the other camera places the row"


def test_frames_are_kept_up_to_a_size() -> None:
    frames = {(0, row): np.full((2, 5), row, dtype=np.uint8) for row in range(4)}
    asked: list[int] = []

    def frame(camera: int, row: int) -> Any:
        asked.append(row)
        return frames.get((camera, row))

    kept = kept_frames(frame, most_bytes=25)
    for _ in range(2):
        assert [kept(0, row) is frames.get((0, row)) for row in range(5)] == [True, True, True, True, True]
    assert asked == [0, 1, 2, 3, 4, 2, 3, 4], "two frames of ten bytes have room; a missing one is asked for again"


def test_the_result_is_the_same_every_time(filmed: Any) -> None:
    again = stitch_frames(filmed.setup, filmed.head, filmed.frame)
    assert again.cad_matrix is not None
    assert np.array_equal(again.cad_matrix, filmed.stitch.cad_matrix)
    assert np.array_equal(again.row_motion, filmed.stitch.row_motion)
    assert again.components == filmed.stitch.components
