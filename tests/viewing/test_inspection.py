"""Inspection of a frame: detected marks and remarks."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.viewing.inspection import find_marks, inspect_frame
from vaoi_station.viewing.mark_spec import MarkSpec

CROSS = MarkSpec("cross", 24.0, light=False)


@pytest.mark.parametrize("spec", [CROSS, MarkSpec("cross", 24.0), MarkSpec("circle", 16.0), MarkSpec("square", 20.0)])
def test_marks_are_detected_at_their_positions(painter: Any, centres: Any, spec: MarkSpec) -> None:
    found = find_marks(painter.marks(spec.shape, spec.size_px), spec)
    assert len(found) == 4
    for x, y in centres:
        assert min(np.hypot(m.x - x, m.y - y) for m in found) < 0.1


def test_a_good_frame_needs_no_remark(painter: Any) -> None:
    look = inspect_frame(painter.marks(), MarkSpec("cross", 24.0, light=False, expected=4))
    assert look.remarks == ()
    assert (look.size_px, look.expected, len(look.marks)) == (24.0, 4, 4)
    assert inspect_frame(painter.tilted_board(0.8), None).remarks == ()


def test_remarks_name_the_value_and_its_limit(painter: Any) -> None:
    board = painter.tilted_board(0.8)
    assert "too bright: " in inspect_frame(cv2.convertScaleAbs(board, alpha=1.3), None).remarks[0]
    assert "dark: the 99th percentile is 20 % of full scale" in inspect_frame(board // 4, None).remarks[0]
    assert inspect_frame(painter.tilted_board(2.0), None).remarks[0].startswith("blurred by ")
    half = np.hstack([painter.tilted_board(0.7)[:, :360], painter.tilted_board(2.5)[:, 360:]])
    assert "check the camera for tilt" in inspect_frame(half, None).remarks[0]
    assert inspect_frame(np.full((100, 100), 120, np.uint8), None).remarks == ("no edges: blur cannot be measured",)


def test_absent_and_damaged_marks_are_reported(painter: Any) -> None:
    assert "no mark found" in inspect_frame(painter.tilted_board(1.0), CROSS).remarks
    assert "no mark found" in inspect_frame(painter.marks(light=True), CROSS).remarks, "of the other polarity"
    covered = painter.marks()
    covered[165:190, 245:262] = 190
    look = inspect_frame(covered, CROSS)
    assert "marks found: 3; a calibration needs 4" in look.remarks
    assert all(m.doubt for m in look.marks if np.hypot(m.x - 260, m.y - 190.75) < 20)
    six = inspect_frame(painter.marks(), MarkSpec("cross", 24.0, light=False, expected=6))
    assert six.remarks == ("marks found: 4 of 6 expected in view",)


def test_16_bit_and_colour_frames_give_the_same_result(painter: Any) -> None:
    plain = painter.marks()
    deep = plain.astype(np.uint16) << 8
    for frame in (deep, np.dstack([plain] * 3)):
        assert len(inspect_frame(frame, CROSS).marks) == 4
