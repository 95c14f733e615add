"""Frames as JSON documents and as text."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vaoi_station.photometry.image_quality import ImageQuality
from vaoi_station.viewing import latest_frames
from vaoi_station.viewing.frame_documents import frame_document, row_text
from vaoi_station.viewing.inspection import FrameInspection, MarkDetection
from vaoi_station.viewing.latest_frames import ViewedFrame

QUALITY = ImageQuality(0.0123456789, 1.23456, 0.15, ((1.0, None),), 0.4, 0.1, 0.9, 0.0012345678)
CONFIG: Any = SimpleNamespace(cameras=[SimpleNamespace(name="left", width=640, height=480, exposure_us=250.0)])


@pytest.fixture
def document(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    marks = (MarkDetection(1.23456, 2.0, 0.98765), MarkDetection(7.77, 8.88, 0.0, "too small"))
    inspection = FrameInspection(QUALITY, marks, 12.3456, 2, ("dark",))
    monkeypatch.setattr(latest_frames, "inspect_frame", lambda *_: inspection)
    frame = ViewedFrame(0, "r1", 3, 17, np.zeros((4, 4), np.uint8), None)
    return frame_document(frame, CONFIG)


def test_a_document_is_json_with_rounded_figures(document: dict[str, Any]) -> None:
    assert json.loads(json.dumps(document)) == document
    assert document["figures"]["focus"] == 0.012346
    assert document["figures"]["blur_px"] == 1.2346
    assert document["figures"]["blur_tiles_px"] == [[1.0, None]]
    assert document["mark_size_px"] == 12.35


def test_it_names_camera_and_frame(document: dict[str, Any]) -> None:
    assert (document["camera"], document["name"], document["number"]) == (0, "left", 17)
    assert (document["run"], document["row"], document["exposure_us"]) == ("r1", 3, 250.0)


def test_usable_and_doubtful_marks_are_separate(document: dict[str, Any]) -> None:
    assert document["marks"] == [{"x": 1.235, "y": 2.0, "score": 0.988}]
    assert document["doubtful"] == [{"x": 7.8, "y": 8.9, "why": "too small"}]


def test_a_row_as_text_has_one_line_per_camera_and_its_remarks(document: dict[str, Any]) -> None:
    missing = {"camera": 1, "name": "right", "missing": "not delivered"}
    lines = row_text({"run": "r1", "row": 3, "rows": 9, "cameras": [document, missing]}).splitlines()
    assert lines[0] == "run r1, row 3 of 9"
    assert lines[1].startswith("camera 0 (left): focus 0.01235, blur 1.23 px (MTF50 0.15 cycles/px), mean 40%")
    assert lines[1].endswith(", 1 marks")
    assert lines[2:] == ["  - dark", "camera 1 (right): no frame: not delivered"]
