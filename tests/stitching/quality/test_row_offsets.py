"""Tests of the rows of neighbouring cameras: a camera that is one row off is named, and not said to have moved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import Status
from vaoi_station.stitching.quality.seams import row_offset, shifted_cameras
from vaoi_station.stitching.quality.verdict import decide_verdict


@pytest.mark.parametrize("late", [1, -1])
def test_a_camera_whose_frames_are_one_row_off_is_named(filmed: Any, late: int) -> None:
    """Its time stamps are late by nearly a period: every frame is taken for that of the next pulse."""
    frames = {(i, j): filmed.frames[i, j - late * i] for i, j in filmed.frames if (i, j - late * i) in filmed.frames}
    found = findings_of(filmed, frames)
    assert found.row_offsets == {(0, 1): late}
    status, reasons = decide_verdict(found)
    assert status is not Status.OK
    (reason,) = [text for code, text in reasons if code == "wrong-rows"]
    assert f"camera 1 match those of camera 0 one row {'earlier' if late > 0 else 'later'}" in reason
    assert not any("moved" in text for _, text in reasons)


def test_cameras_in_the_right_rows_have_no_offset(filmed: Any) -> None:
    sound = findings_of(filmed)
    assert sound.row_offsets == {}
    assert row_offset(sound.scene, sound.links, 0) == 0


def test_a_camera_whose_neighbouring_rows_are_missing_has_no_offset(filmed: Any) -> None:
    """Hostile drawing 101170: the overlap was searched in rows of which the other camera had no frame."""
    sound = findings_of(filmed)
    alone = replace(sound.scene, present=tuple(key for key in sound.scene.present if key[0] == 0))
    assert row_offset(alone, sound.links, 0) == 0


@pytest.mark.parametrize(
    ("offsets", "cameras", "shifted"),
    [
        ({}, 3, {}),
        ({(0, 1): 1}, 2, {}),  # either of the two
        ({(0, 1): 1}, 3, {0: -1}),
        ({(0, 1): 1, (1, 2): -1}, 3, {1: 1}),
        ({(2, 3): -1}, 4, {3: -1}),
        ({(1, 2): 1}, 4, {}),  # two against two
    ],
)
def test_the_cameras_that_differ_from_most_are_shifted(
    offsets: dict[tuple[int, int], int], cameras: int, shifted: dict[int, int]
) -> None:
    assert shifted_cameras(offsets, cameras) == shifted
